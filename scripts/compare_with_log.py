"""`drake-quad compare-log`, from a checkout."""

from drake_quad.command_line.main import main

if __name__ == "__main__":
    main("compare-log")
