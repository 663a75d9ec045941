"""``python -m scanweave`` is the command ``scanweave``."""

from ._command import main

if __name__ == "__main__":
    main()
