"""Contract check for simulated plants."""

from collections.abc import Callable

import numpy as np

from dcf_zenoh.plant import Plant, Setpoint


def check_plant(make: Callable[[], Plant], *, sample_time: int = 200_000_000, steps: int = 20) -> None:
    """Check the contract of a simulated plant: sensing changes nothing, states are read-only, holding comes to rest.

    Args:
        make: Makes a new plant, the same each time.
        sample_time: Time between setpoints, in ns.
        steps: Number of setpoints to try.

    Raises:
        AssertionError: The plant breaks the contract; the message states how.
    """
    seldom, often = make(), make()
    for plant in (seldom, often):
        plant.prepare()
        plant.start(0)
    rng = np.random.default_rng(0)
    for step in range(steps):
        now = step * sample_time
        state, again = seldom.sense(now), often.sense(now)
        assert np.allclose(state.vector, again.vector, rtol=1e-9, atol=1e-9), f"step {step}: sensing moves the plant"
        assert np.array_equal(often.sense(now).vector, again.vector), f"step {step}: two states at one instant"
        assert state.position.shape == state.velocity.shape, f"step {step}: position and velocity differ in shape"
        locked = [not array.flags.writeable for array in (state.position, state.velocity)]
        assert all(locked), f"step {step}: a state can be changed"
        setpoint = Setpoint(state.position, state.velocity, rng.uniform(-1, 1, state.position.shape))
        for plant in (seldom, often):
            plant.act(setpoint, now)
        often.sense(now + sample_time // 3)
    end = steps * sample_time
    seldom.act(Setpoint.hold(seldom.sense(end)), end)
    rest = seldom.sense(end + 100 * sample_time)
    later = seldom.sense(end + 101 * sample_time)
    assert np.allclose(rest.velocity, 0, atol=1e-3), f"it still moves at {rest.velocity} m/s long after it was to hold"
    assert np.allclose(rest.position, later.position, atol=1e-3), "it does not stay where it holds"
    for plant in (seldom, often):
        plant.finish(end, "done")
        plant.close()
        plant.close()
