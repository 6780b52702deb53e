"""A package of somebody else, as pip installs it."""

import subprocess
import sys

PROJECT = """\
[build-system]
requires = ["setuptools>=65"]
build-backend = "setuptools.build_meta"
[project]
name = "{name}"
version = "1.0"
[project.entry-points."{group}"]
{entries}
[tool.setuptools]
py-modules = {modules}
"""


def install(folder, name, modules, group, entries):
    """Build and install a package; the folder that must be on the path.

    Args:
        folder: Empty, for sources and result.
        name: Of the package.
        modules: Name -> source.
        group: Of its entry points.
        entries: Entry point -> target.
    """
    source, target = folder / "source", folder / "target"
    source.mkdir()
    for module, text in modules.items():
        (source / f"{module}.py").write_text(text, encoding="utf-8")
    lines = "\n".join(f'{key} = "{value}"' for key, value in entries.items())
    project = PROJECT.format(name=name, group=group, entries=lines, modules=[*modules])
    (source / "pyproject.toml").write_text(project, encoding="utf-8")
    words = ["install", "--quiet", "--no-deps", "--no-index", "--no-build-isolation"]
    pip = [sys.executable, "-m", "pip", *words, "--target", target, source]
    subprocess.run(pip, check=True, capture_output=True)
    return target
