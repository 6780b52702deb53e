"""Machine, versions and commit of a report."""

import os
import platform
import subprocess
from pathlib import Path
from typing import Any

import mbd_ros
from mbd_ros.applications.report.program import VERSIONS, versions
from mbd_ros.jobs.workers.opening import cores
from mbd_ros.jobs.workers.task import cpu

_SHOWN = ("mbd_ros", *VERSIONS, "matplotlib", "dask")
_GIB = 2**30


def machine() -> dict[str, Any]:
    """Processor, memory, system and load."""
    described = {"cpu": cpu(), "cores": cores(), "system": platform.platform()}
    if hasattr(os, "sysconf"):
        size = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        described["memory"] = f"{size / _GIB:.1f} GiB"
    if hasattr(os, "getloadavg"):
        described["load"] = f"{os.getloadavg()[0]:.2f} at the start"
    return described


def package_versions() -> dict[str, str]:
    """Versions of this package and of its libraries."""
    return versions(_SHOWN)


def git_state() -> dict[str, Any]:
    """Commit of the checkout, and whether it was changed; empty outside of one."""
    package = Path(mbd_ros.__path__[0])
    try:
        if not _git(package, "ls-files", "cli.py"):
            return {}
        changed = bool(_git(package, "status", "--porcelain", "--untracked-files=all", "."))
        return {"commit": _git(package, "rev-parse", "HEAD"), "changed": changed}
    except (OSError, subprocess.SubprocessError):
        return {}


def _git(folder: Path, *words: str) -> str:
    command = ["git", "-C", str(folder), *words]
    ran = subprocess.run(command, capture_output=True, text=True, check=True, timeout=30)
    return ran.stdout.strip()
