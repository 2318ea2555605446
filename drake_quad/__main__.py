"""Entry point of `python -m drake_quad`, which is the same command line as `drake-quad`."""

from drake_quad.command_line.main import main

if __name__ == "__main__":
    main()
