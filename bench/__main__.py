"""`python -m bench`: the same as the command `starbench`."""

from bench.front_door import main

if __name__ == "__main__":
    main()
