"""A scene of Hypersim's layout with pictures of 6 x 4 pixels, written by the HDF5 library as the authors' own program
writes it (gzip, level 9): the files of `datasets/tests/data/hypersim`.

    venv/bin/pip install h5py==3.16.0 numpy==2.4.6
    venv/bin/python hypersim_miniature.py ../../datasets/tests/data/hypersim/ai_000_001

A floor 50 units (half a metre) between pixels; the last column is a table, whose first pixel the second picture calls
floor. One pixel shows nothing, one has no label. The third picture belongs to another camera and shows the table alone.
"""

import sys
from pathlib import Path

import h5py
import numpy as np

HEIGHT, WIDTH = 4, 6
FLOOR, TABLE = 2, 7


def write(path, data):
    path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(path, "w") as f:
        f.create_dataset("dataset", data=data, compression="gzip", compression_opts=9)


def main():
    folder = Path(sys.argv[1])
    detail = folder / "_detail"
    detail.mkdir(parents=True, exist_ok=True)
    (detail / "metadata_scene.csv").write_text("parameter_name,parameter_value\nmeters_per_asset_unit,0.01\n")
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    for camera, frame, offset in [("cam_00", 0, 0.0), ("cam_00", 3, 0.5), ("cam_01", 0, -0.25)]:
        # The middle of a cube of 2 cm, and a little beside it.
        position = np.stack([50.0 * columns + 1.0 + offset, 50.0 * rows + 1.0, np.ones((HEIGHT, WIDTH))], axis=2)
        semantic = np.where(columns == WIDTH - 1, TABLE, FLOOR)
        instance = np.where(columns == WIDTH - 1, 4, 1)
        normal = np.broadcast_to([0.0, 0.0, 1.0], position.shape).copy()
        if camera == "cam_00" and frame == 3:
            semantic[0, -1], instance[0, -1] = FLOOR, 1
        if camera == "cam_01":
            hidden = columns < WIDTH - 1
        else:
            hidden = (rows == 0) & (columns == 0)
        position[hidden], normal[hidden], semantic[hidden], instance[hidden] = np.nan, np.nan, -1, -1
        semantic[3, 0], instance[3, 0] = -1, -1
        place = folder / "images" / f"scene_{camera}_geometry_hdf5"
        stem = f"frame.{frame:04d}"
        write(place / f"{stem}.position.hdf5", position.astype(np.float16))
        write(place / f"{stem}.normal_world.hdf5", normal.astype(np.float16))
        write(place / f"{stem}.semantic.hdf5", semantic.astype(np.int16))
        write(place / f"{stem}.semantic_instance.hdf5", instance.astype(np.int16))


if __name__ == "__main__":
    main()
