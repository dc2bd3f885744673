"""The process that draws some of the cameras: `python -m armsight_sim.painter CONNECTION MEMORY`, two descriptors.

Each request has the state of the model, each reply says that the pictures are in the memory, or what is wrong.
"""

import mmap
import sys
from multiprocessing.connection import Connection

import mujoco
import numpy as np

from armsight_sim.cameras import Cameras, Commission
from armsight_sim.painters import STATE, bytes_of, pictures_in


def main(descriptor: int, memory: int) -> None:
    """Paints until the connection ends."""
    connection: Connection = Connection(descriptor)
    commission: Commission = connection.recv()
    model = commission.model
    try:
        cameras = Cameras(commission)
    except Exception as error:  # whatever OpenGL has to say
        connection.send_bytes(str(error).encode() or b"no reason told")
        return
    data = mujoco.MjData(model)
    pictures = pictures_in(mmap.mmap(memory, bytes_of(commission)), commission)
    connection.send_bytes(b"")
    while True:
        try:
            wanted = np.frombuffer(connection.recv_bytes())
        except EOFError:
            break
        mujoco.mj_setState(model, data, wanted[:-1], STATE)
        # where everything is, cameras and lights on moving bodies too
        mujoco.mj_fwdPosition(model, data)
        cameras.light(float(wanted[-1]))
        cameras.draw(data, pictures)
        connection.send_bytes(b"")
    cameras.close()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
