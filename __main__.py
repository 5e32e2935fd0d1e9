"""``python -m nbv_gym`` is the console script ``nbv-gym``."""

from .training.cli import main

if __name__ == "__main__":
    main()
