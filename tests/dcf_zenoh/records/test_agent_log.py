from io import BytesIO

import numpy as np

from dcf_zenoh.plant import Setpoint, State, read_only
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.log_writer import Recorder, StepRecord


def test_setpoints_in_the_plane_and_in_space_share_a_table() -> None:
    # A body in space is told plane setpoints, and holds in space.
    state = State(read_only([1.0, 2.0, 3.0]), read_only([4.0, 5.0, 6.0]))
    plane = Setpoint(read_only([0.1, 0.2]), read_only([0.3, 0.4]), read_only([0.5, 0.6]))
    stream = BytesIO()
    recorder = Recorder(stream, 1, {})
    for step, setpoint in enumerate((plane, Setpoint.hold(state))):
        recorder.step(StepRecord.abstained(step, step, state, setpoint, ""))
    log = AgentLog.read(stream.getvalue(), "test")
    nothing = np.nan
    np.testing.assert_array_equal(log.setpoint[0], [0.1, 0.2, nothing, 0.3, 0.4, nothing, 0.5, 0.6, nothing])
    np.testing.assert_array_equal(log.setpoint[1], [1, 2, 3, 0, 0, 0, nothing, nothing, nothing])
