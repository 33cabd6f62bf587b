"""``python -m roclog``."""

from roclog.cli import main

main()
