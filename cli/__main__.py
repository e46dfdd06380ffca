"""`python -m karolos_cli`: the `karolos` command."""

from .main import main

main()
