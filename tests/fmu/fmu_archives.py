"""Change the content of an FMU, as other tools and bad luck do."""

import zipfile


def changed(path, target, drop=(), replace=None):
    """A copy of the FMU without the members that start with one of `drop`, with those of `replace`."""
    replace = dict(replace or {})
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            if not name.startswith(tuple(drop)) and name not in replace:
                new.writestr(name, old.read(name))
        for name, content in replace.items():
            new.writestr(name, content)
    return target


def member(path, name):
    with zipfile.ZipFile(path) as archive:
        return archive.read(name).decode()
