"""`python -m drake_quad` is `drake-quad`."""

from drake_quad.command_line.main import main

if __name__ == "__main__":
    main()
