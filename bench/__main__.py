"""`python -m bench` is `starbench`."""

from bench.cli import main

if __name__ == "__main__":
    main()
