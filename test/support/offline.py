"""Cases that several tests share: offline."""

from places import ROOT

SCENES = ROOT / "config/scenes"
