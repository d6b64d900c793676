"""``python -m cagemap``: the command `cagemap`, also if it is not on the PATH."""

from cagemap.cli import main

if __name__ == "__main__":  # workers of a job import this module as well
    main()
