"""Checksums of pictures that Pillow resized, for `crates/vision/tests/suite/resize.rs`.

    venv/bin/pip install pillow==11.3.0
    venv/bin/python pillow_resize.py > ../../crates/vision/tests/data/pillow_resize.csv

From 13 on Pillow resizes heights first where they shrink much more than widths; networks and labels are older.

A line: filter, width and height before, width and height after, FNV-1a (64 bits) of the bytes.
"""

import PIL
from PIL import Image

MASK = (1 << 64) - 1


def fnv(data):
    code = 0xCBF29CE484222325
    for byte in data:
        code = ((code ^ byte) * 0x100000001B3) & MASK
    return code


def unit(state):
    """The next of a sequence of 64-bit numbers, and a byte of it (splitmix64)."""
    state = (state + 0x9E3779B97F4A7C15) & MASK
    z = state
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return state, z ^ (z >> 31)


def picture(width, height):
    """Noise beside edges: bytes 0 and 255 at full contrast make rounding and clipping show."""
    state = width * 65537 + height
    data = bytearray()
    for i in range(width * height * 3):
        state, value = unit(state)
        x = i // 3 % width
        data.append(255 * (value >> 63) if x % 16 < 8 else value >> 56)
    return Image.frombytes("RGB", (width, height), bytes(data))


def sizes():
    fixed = [
        (1, 1, 1, 1), (1, 1, 7, 5), (7, 5, 1, 1), (2, 2, 3, 3), (3, 3, 2, 2), (1, 50, 20, 20),
        (50, 1, 20, 20), (64, 64, 64, 64), (64, 48, 64, 96), (64, 48, 128, 48), (100, 75, 512, 512),
        (640, 480, 512, 512), (616, 456, 512, 512), (97, 61, 512, 512), (300, 200, 1024, 1024),
        (13, 1021, 16, 16), (1021, 13, 16, 16), (255, 257, 256, 256), (512, 512, 511, 513),
        (33, 77, 224, 224),
    ]
    state = 19
    while len(fixed) < 50:
        row = []
        for _ in range(4):
            state, value = unit(state)
            row.append(1 + value % 300)
        fixed.append(tuple(row))
    return fixed


if __name__ == "__main__":
    print(f"# Pillow {PIL.__version__}")
    for width, height, to_width, to_height in sizes():
        for name, filter in [("bilinear", Image.BILINEAR), ("bicubic", Image.BICUBIC)]:
            small = picture(width, height).resize((to_width, to_height), filter)
            print(f"{name},{width},{height},{to_width},{to_height},{fnv(small.tobytes()):016x}")
