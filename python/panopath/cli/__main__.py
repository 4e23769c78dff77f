"""``python -m panopath.cli``."""

from panopath.cli import main

main()
