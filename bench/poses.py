"""What vision makes of given poses, marker by marker: for whoever looks for the cause of one error.

python bench/poses.py 0,-1.53,1.53,0.67 3.06,0.93,1.57,1.39
"""

import json
import sys
from dataclasses import asdict

import numpy as np
from pictures import scene

if __name__ == "__main__":
    poses = [[float(angle) for angle in pose.split(",")] for pose in sys.argv[1:]]
    with scene() as arm:
        print(json.dumps([{"pose": q, **asdict(sample)} for q in poses for sample in arm.samples_at(np.array(q))]))
