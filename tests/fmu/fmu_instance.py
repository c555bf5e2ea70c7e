"""An FMU of ours in this process: the tests of the exported code look at it call by call."""

from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from daest.fmu.instance import Instance, Log
from daest.fmu.runner import unpacked_binary


@contextmanager
def open_instance(model, dae_mode=False):
    with TemporaryDirectory(prefix="daest-test-", ignore_cleanup_errors=True) as folder:
        instance = Instance(unpacked_binary(model, Path(folder)), Log())
        instance.start(dae_mode=dae_mode)
        yield instance
        instance.free()
