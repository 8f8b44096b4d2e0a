"""``python -m panoscope``: the command ``panoscope`` of the installation."""

from .installation import main

if __name__ == "__main__":
    main()
