"""``python -m binocal``."""

import sys

from binocal.cli import main

sys.exit(main())
