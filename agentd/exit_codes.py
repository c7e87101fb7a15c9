"""What `agentd` says when it ends."""

DONE = 0
FAILED = 1  # a run failed, or two runs differ
MISUSED = 2  # the command line or the fleet file is wrong
NEIGHBOUR_LOST = 3  # an agent failed because another agent of the fleet did
INTERRUPTED = 130
