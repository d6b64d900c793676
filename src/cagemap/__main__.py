"""``python -m cagemap`` is the command `cagemap`, also where the folder of commands is not on the PATH."""

from cagemap.cli import main

if __name__ == "__main__":  # workers of a job import this module as well
    main()
