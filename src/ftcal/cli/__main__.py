"""`python -m ftcal.cli`."""

from ftcal.cli import main

main()
