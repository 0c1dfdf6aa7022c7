"""``python -m sagnode`` is the same as the ``sagnode`` command."""

import sys

from sagnode.cli.main import main

sys.exit(main())
