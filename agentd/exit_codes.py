"""Exit codes of `agentd`."""

import signal

from dcf_zenoh.errors import (
    ConfigurationError,
    DcfError,
    HasFindings,
    Interrupted,
    LogIncomplete,
    NeighbourLost,
    Stopped,
)

DONE = 0
FAILED = 1  # a run failed, or two runs differ
MISUSED = 2  # the command line or the fleet file is wrong
NEIGHBOUR_LOST = 3  # an agent failed because another agent of the fleet did
STOPPED = 4  # an operator or the launcher ended an agent early
UNRECORDED = 5  # an agent reached its end, but its log is incomplete
FOUND = 6  # a run has findings, and --strict was given
SIGNALLED = 128  # plus the number of the signal that stopped the command
CTRL_C = SIGNALLED + signal.SIGINT


def of(error: DcfError) -> int:
    """Return the exit code for an error."""
    if isinstance(error, Interrupted):
        return SIGNALLED + error.signal
    if isinstance(error, NeighbourLost):
        return NEIGHBOUR_LOST
    if isinstance(error, Stopped):
        return STOPPED
    if isinstance(error, LogIncomplete):
        return UNRECORDED
    if isinstance(error, HasFindings):
        return FOUND
    return MISUSED if isinstance(error, ConfigurationError) else FAILED
