"""Cases that several tests share: loads."""

import numpy as np

from mbd_ros.files.table import Column, Result, Table

ROD = """<robot name="rod"><link name="wall"/><link name="rod"><inertial><origin xyz="0.5 0 0"/>
<mass value="2"/><inertia ixx="1e-3" iyy="0.16666" izz="0.16666" ixy="0" ixz="0" iyz="0"/>
</inertial></link><link name="tip"><inertial><mass value="0.5"/><inertia ixx="1e-4" iyy="1e-4"
izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="wall"/><child link="rod"/><origin xyz="0 0 0"/>
<axis xyz="0 0 1"/></joint><joint name="weld" type="fixed"><parent link="rod"/><child link="tip"/>
<origin xyz="1 0 0"/></joint></robot>"""


RATE = 30.0


def spin(count=5):
    t = np.arange(count) * 0.01
    still = np.zeros(count)
    names = ("position", RATE * t), ("velocity", still + RATE), ("acceleration", still)
    return Result(
        {"samples": Table([Column("time", t), *(Column(f"hinge.{n}", v) for n, v in names)])}
    )
