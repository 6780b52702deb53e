"""Cases that several tests share: actuators."""

from places import ROOT

from mbd_ros.core.model.robot_reader import read_robot

LEG = (ROOT / "config/robots/prosthetic_leg.urdf").read_text(encoding="utf-8")


FIXED, FREE = read_robot(LEG), read_robot(LEG, base="floating")
