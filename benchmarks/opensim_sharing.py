"""Static optimisation by OpenSim, timed: run by the Python that has the wheel `opensim`.

python opensim_sharing.py MODEL MOTION EXTERNAL RESERVES CUTOFF

Prints JSON: CPU seconds of the tool, frames, and what frames cost beside one frame alone.
"""

import contextlib
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import opensim


def main() -> int:
    """Run the tool on all frames and on two."""
    words = [str(Path(word).absolute()) for word in sys.argv[1:5]]
    opensim.Logger.setLevelString("off")
    motion = opensim.Storage(words[1])
    first, last = motion.getFirstTime(), motion.getLastTime()
    step = (last - first) / (motion.getSize() - 1)
    with tempfile.TemporaryDirectory() as folder, quiet():
        few = timed(words, float(sys.argv[5]), (first, first + 1.5 * step), folder)
        whole = timed(words, float(sys.argv[5]), (first, last), folder)
    frames = motion.getSize()
    json.dump({"frames": frames, "seconds": whole, "per_frame": (whole - few) / (frames - 2)},
              sys.stdout)  # fmt: skip
    return 0


def timed(words: list[str], cutoff: float, times: tuple[float, float], folder: str) -> float:
    """CPU seconds of a run of the tool."""
    model, motion, external, reserves = words
    tool = opensim.AnalyzeTool()
    tool.setModelFilename(model)
    tool.setCoordinatesFileName(motion)
    tool.setExternalLoadsFileName(external)
    tool.setLowpassCutoffFrequency(cutoff)
    tool.setInitialTime(times[0])
    tool.setFinalTime(times[1])
    files = opensim.ArrayStr()
    files.append(reserves)
    tool.setForceSetFiles(files)
    tool.setReplaceForceSet(False)
    tool.setResultsDir(folder)
    analysis = opensim.StaticOptimization()
    analysis.setUseModelForceSet(True)
    tool.updAnalysisSet().cloneAndAppend(analysis)
    setup = str(Path(folder) / "setup.xml")
    tool.printToXML(setup)
    tool = opensim.AnalyzeTool(setup)
    begin = time.process_time()
    tool.run()
    return time.process_time() - begin


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Nothing on stdout, where the tool writes by itself."""
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)


if __name__ == "__main__":
    sys.exit(main())
