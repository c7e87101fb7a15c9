"""The daemon of one agent, the launcher of a fleet, and the command line.

Importing this package sets the number of BLAS threads to one, in this process and its children, because with more
threads the last bits of matrix products may differ. It has to be imported before numpy.
"""

import os

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ[name] = "1"
