"""Parts of other packages: the ones that the pages show, as files of their own."""

import re

from places import ROOT

DOCS = ROOT / "docs"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
OUTSIDE = {  # section -> type -> arguments on the prosthetic leg
    "actuators": {
        "wound_motor:WoundMotor": {
            **{"joint": "ankle", "constant": 1.2, "resistance": 0.8, "inductance": 0.02},
        },
        "voltage_motor:VoltageMotor": {"joint": "knee", "constant": 1.2, "resistance": 0.8},
    },
    "constraints": {
        "level_tool:LevelTool": {"first": "hip_flexion", "second": "knee", "angle": 0.3},
    },
    "controllers": {"soft_spring:SoftSpring": {"kp": 60.0, "reach": 0.2}},
    "forces": {
        "hard_spring:HardSpring": {"joint": "ankle", "stiffness": 3.0, "cubic": 40.0},
        "escapement:Escapement": {"joint": "ankle", "speed": 0.2},
    },
}
MODULES = {
    "voltage_motor": "extend.md",
    "wound_motor": "extend.md",
    "level_tool": "extend.md",
    "hard_spring": "extend.md",
    "escapement": "extend.md",
    "soft_spring": "control.md",
}


def write(folder):
    """One file a part, as the pages have them."""
    for module, page in MODULES.items():
        blocks = BLOCK.findall((DOCS / page).read_text(encoding="utf-8"))
        (code,) = (b for b in blocks if page != "extend.md" or b.startswith(f"# {module}.py\n"))
        (folder / f"{module}.py").write_text(code, encoding="utf-8")
