"""`python -m smr_gpu_train`."""

import sys

from .cli import main

sys.exit(main())
