"""The live page: a server on this machine that shows what stands in a project and starts `daest` commands."""
