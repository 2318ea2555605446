"""Flight of exported controllers: C code that `drake-quad export` wrote, compiled and called in the loop."""
