"""`python -m palpate`: the command line."""

from palpate.cli.main import main

if __name__ == "__main__":
    main()
