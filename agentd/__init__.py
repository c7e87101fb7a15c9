"""The daemon of one agent, the launcher of a fleet, and the command line.

Importing this package fixes the number of BLAS threads to one, here and in child processes. That must happen before
numpy is imported; with more threads matrix products may differ in their last bits.
"""

import os

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ[name] = "1"
