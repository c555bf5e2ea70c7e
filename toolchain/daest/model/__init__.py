"""Values that the toolchain passes from stage to stage. They hold data and check it; no algorithm lives
here."""
