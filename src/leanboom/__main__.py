"""`python -m leanboom` is the command `leanboom`."""

from leanboom.cli import main

if __name__ == "__main__":
    main()
