"""``python -m sagnode.worker``: started by the daemon's supervisor, never by hand."""

import sys

from sagnode.worker.child import main

sys.exit(main(sys.argv[1:]))
