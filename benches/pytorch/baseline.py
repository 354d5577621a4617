"""The language and segmentation networks in plain PyTorch, to compare speed with.

Point Transformer V3 as SceneSplat configures it, forward pass only, on the CPU, in f32: sparse
convolutions gather, multiply and add tap by tap; attention is PyTorch's own fused kernel over
equal patches; batch norms use stored statistics. Serialization and kernel maps are part of the
timed pass, as they are in the Rust programs. Weights come from the integer hash that
`WeightSource::hashed` uses, so both compute the same numbers.

    python baseline.py --config language --input SCENE [--threads 2] [--runs 3]
    python baseline.py --config language --check GOLDEN.safetensors

SCENE is the common start of `…_grid_i32.npy` and `…_feat11_f32.npy` (a segmentation network, which
reads normals, gets hashed ones). Versions this was checked with are in README.md.
"""

import argparse
import gc
import math
import resource
import statistics
import sys
import time

import numpy as np
import torch
import torch.nn.functional as F

CONFIGS = {
    "language": {
        "in_channels": 11,
        "enc_depths": (2, 2, 2, 6),
        "enc_channels": (32, 64, 128, 256),
        "enc_heads": (2, 4, 8, 16),
        "dec_depths": (2, 2, 2),
        "dec_channels": (768, 512, 256),
        "dec_heads": (16, 16, 16),
        "classes": None,
        "prefix": "",
    },
    "semseg": {
        "in_channels": 14,
        "enc_depths": (2, 2, 2, 6, 2),
        "enc_channels": (32, 64, 128, 256, 512),
        "enc_heads": (2, 4, 8, 16, 32),
        "dec_depths": (2, 2, 2, 2),
        "dec_channels": (64, 64, 128, 256),
        "dec_heads": (4, 4, 8, 16),
        "classes": 20,
        "prefix": "backbone.",
    },
}
# Where tensors lie, and what products compute in.
DEVICE, DTYPE = "cpu", torch.float32
PATCH = 1024
MLP_RATIO = 4
BATCH_NORM_EPS = 1e-3
LAYER_NORM_EPS = 1e-5


# ---- Weights from the integer hash. ----


def place(tensor):
    return tensor.to(DEVICE, DTYPE if tensor.is_floating_point() else tensor.dtype)


def synchronize():
    if DEVICE != "cpu":
        torch.cuda.synchronize()


def unit(name, count, seed):
    """`count` multiples of 2^-23 in -1..1."""
    mask = (1 << 64) - 1
    h = 0xCBF29CE484222325
    for byte in name.encode():
        h = ((h ^ byte) * 0x100000001B3) & mask
    h ^= (seed * 0xD6E8FEB86659FD93) & mask
    z = np.arange(1, count + 1, dtype=np.uint64)
    z *= np.uint64(0x9E3779B97F4A7C15)
    z += np.uint64(h)
    for shift, factor in [(30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)]:
        z ^= z >> np.uint64(shift)
        z *= np.uint64(factor)
    z ^= z >> np.uint64(31)
    return ((z >> np.uint64(40)).astype(np.int64) - 8388608).astype(np.float32) * np.float32(2**-23)


class HashedWeights:
    def __init__(self, seed, prefix):
        self.seed, self.prefix = seed, prefix

    def get(self, name, *shape):
        full = name if name.startswith("seg_head.") else self.prefix + name
        values = unit(full, math.prod(shape), self.seed)
        last = name.rsplit(".", 1)[-1]
        if last == "running_mean":
            offset, factor = 0.0, 0.125
        elif last == "running_var":
            offset, factor = 1.0, 0.5
        elif len(shape) == 1:
            offset, factor = (1.0, 0.25) if last == "weight" else (0.0, 0.125)
        else:
            offset, factor = 0.0, np.float32(math.sqrt(3.0 / math.prod(shape[1:])))
            if name.endswith("qkv.weight"):
                factor *= np.float32(2)
        values *= np.float32(factor)
        values += np.float32(offset)
        return place(torch.from_numpy(values).reshape(shape))


# ---- Space-filling curves. ----


def interleave(x, y, z, depth):
    code = torch.zeros_like(x)
    for bit in range(depth):
        for place, axis in ((2, x), (1, y), (0, z)):
            code |= ((axis >> bit) & 1) << (3 * bit + place)
    return code


def hilbert(x, y, z, depth):
    """Skilling's transform, then the bits as a Gray code."""
    axes = [x.clone(), y.clone(), z.clone()]
    for level in range(depth - 1, -1, -1):
        low = (1 << level) - 1
        for d in range(3):
            is_set = ((axes[d] >> level) & 1).bool()
            swapped = (axes[0] ^ axes[d]) & low
            first = torch.where(is_set, axes[0] ^ low, axes[0] ^ swapped)
            if d > 0:
                axes[d] = torch.where(is_set, axes[d], axes[d] ^ swapped)
            else:
                first = torch.where(is_set, axes[0] ^ low, axes[0])
            axes[0] = first
    code = interleave(*axes, depth)
    shift = 1
    while shift < 3 * depth:
        code ^= code >> shift
        shift *= 2
    return code


def curve_codes(grid, depth):
    x, y, z = grid.unbind(1)
    return torch.stack(
        [
            interleave(x, y, z, depth),
            interleave(y, x, z, depth),
            hilbert(x, y, z, depth),
            hilbert(y, x, z, depth),
        ]
    )


def patch_slots(n, size):
    """Position of each slot, so that all patches are full: the last one borrows from its neighbour."""
    slots = torch.arange(n)
    rest = n % size
    if n > size and rest:
        start = (n // size - 1) * size
        slots = torch.cat([slots, torch.arange(start + rest, start + size)])
    return slots


class Cloud:
    """Voxels of one scale of one scene, with orders and tables made at first use."""

    def __init__(self, grid, codes, depth):
        self.grid, self.codes, self.depth = grid, codes, depth
        self.orders = torch.argsort(codes, dim=1)
        self.inverses = torch.empty_like(self.orders)
        rows = torch.arange(len(grid)).expand_as(self.orders)
        self.inverses.scatter_(1, self.orders, rows)
        self.slots = patch_slots(len(grid), PATCH)
        self.maps = {}

    @classmethod
    def of(cls, grid):
        depth = int(grid.max()).bit_length()
        return cls(grid, curve_codes(grid, depth), depth)

    def kernel_map(self, k):
        """For every tap but the centre: (tap, input rows, output rows)."""
        if k in self.maps:
            return self.maps[k]
        half = k // 2
        side = self.grid.amax(0) + 2 * half + 1
        strides = torch.stack([side[1] * side[2], side[2], torch.ones_like(side[2])])
        keys = ((self.grid + half) * strides).sum(1)
        sorted_keys, order = torch.sort(keys)
        pairs = []
        taps = k**3
        # Taps come in mirrored pairs that use the same voxels the other way round.
        for tap in range(taps // 2):
            delta = torch.tensor([tap // (k * k), tap // k % k, tap % k]) - half
            wanted = sorted_keys + (delta * strides).sum()
            at = torch.searchsorted(sorted_keys, wanted).clamp_(max=len(keys) - 1)
            found = (sorted_keys[at] == wanted).nonzero().squeeze(1)
            source, target = order[at[found]], order[found]
            pairs.append((tap, source, target))
            pairs.append((taps - 1 - tap, target, source))
        self.maps[k] = pairs
        return pairs

    def pool(self):
        """The scale with voxels of double size, and the coarse row of each row."""
        shift = 1 if self.depth > 0 else 0
        codes = self.codes >> (3 * shift)
        _, cluster, counts = torch.unique(codes[0], return_inverse=True, return_counts=True)
        by_cluster = torch.argsort(cluster)
        heads = by_cluster[torch.cumsum(counts, 0) - counts]
        coarse = Cloud(self.grid[heads] >> shift, codes[:, heads], self.depth - shift)
        return coarse, cluster, counts


# ---- Layers. ----


class Linear:
    def __init__(self, w, name, cin, cout):
        self.weight, self.bias = w.get(f"{name}.weight", cout, cin), w.get(f"{name}.bias", cout)

    def __call__(self, x):
        return F.linear(x, self.weight, self.bias)


class LayerNorm:
    def __init__(self, w, name, c):
        self.shape, self.weight, self.bias = (c,), w.get(f"{name}.weight", c), w.get(f"{name}.bias", c)

    def __call__(self, x):
        return F.layer_norm(x, self.shape, self.weight, self.bias, LAYER_NORM_EPS)


class BatchNormGelu:
    def __init__(self, w, name, c):
        parts = ("running_mean", "running_var", "weight", "bias")
        self.parts = [w.get(f"{name}.{p}", c) for p in parts]

    def __call__(self, x):
        return F.gelu(F.batch_norm(x, *self.parts, training=False, eps=BATCH_NORM_EPS))


class SparseConv:
    def __init__(self, w, name, cin, cout, k, bias):
        self.k = k
        weight = w.get(f"{name}.weight", cout, k, k, k, cin).reshape(cout, k**3, cin)
        self.taps = weight.permute(1, 2, 0).contiguous()
        self.bias = w.get(f"{name}.bias", cout) if bias else None

    def __call__(self, x, cloud):
        centre = self.k**3 // 2
        out = x @ self.taps[centre]
        if self.bias is not None:
            out += self.bias
        for tap, source, target in cloud.kernel_map(self.k):
            if len(source):
                out.index_add_(0, target, x.index_select(0, source) @ self.taps[tap])
        return out


class Attention:
    def __init__(self, w, name, c, heads, order):
        self.heads, self.dim, self.order = heads, c // heads, order
        self.qkv = Linear(w, f"{name}.qkv", c, 3 * c)
        self.proj = Linear(w, f"{name}.proj", c, c)

    def __call__(self, x, cloud):
        n, c = x.shape
        rows = cloud.orders[self.order][cloud.slots]
        size = min(n, PATCH)
        qkv = self.qkv(x).index_select(0, rows)
        q, k, v = qkv.view(-1, size, 3, self.heads, self.dim).permute(2, 0, 3, 1, 4)
        y = F.scaled_dot_product_attention(q, k, v).transpose(1, 2).reshape(-1, c)
        # Borrowed slots come last and are not asked for.
        return self.proj(y.index_select(0, cloud.inverses[self.order]))


class Block:
    def __init__(self, w, name, c, heads, order):
        self.conv = SparseConv(w, f"{name}.cpe.0", c, c, 3, bias=True)
        self.conv_linear = Linear(w, f"{name}.cpe.1", c, c)
        self.conv_norm = LayerNorm(w, f"{name}.cpe.2", c)
        self.norm1 = LayerNorm(w, f"{name}.norm1.0", c)
        self.attention = Attention(w, f"{name}.attn", c, heads, order)
        self.norm2 = LayerNorm(w, f"{name}.norm2.0", c)
        self.fc1 = Linear(w, f"{name}.mlp.0.fc1", c, MLP_RATIO * c)
        self.fc2 = Linear(w, f"{name}.mlp.0.fc2", MLP_RATIO * c, c)

    def __call__(self, x, cloud, conv_input=None):
        conv = self.conv(x if conv_input is None else conv_input, cloud)
        x = x + self.conv_norm(self.conv_linear(conv))
        x = x + self.attention(self.norm1(x), cloud)
        return x + self.fc2(F.gelu(self.fc1(self.norm2(x))))


class Network:
    def __init__(self, config, w):
        enc, dec = config["enc_channels"], config["dec_channels"]
        self.stem = SparseConv(w, "embedding.stem.conv", config["in_channels"], enc[0], 5, bias=False)
        self.stem_norm = BatchNormGelu(w, "embedding.stem.norm", enc[0])

        def blocks(name, depth, c, heads):
            return [Block(w, f"{name}.block{i}", c, heads, i % 4) for i in range(depth)]

        self.encoder = []
        for s, (c, depth, heads) in enumerate(zip(enc, config["enc_depths"], config["enc_heads"])):
            name = f"enc.enc{s}"
            down = None
            if s > 0:
                down = (
                    Linear(w, f"{name}.down.proj", enc[s - 1], c),
                    BatchNormGelu(w, f"{name}.down.norm.0", c),
                )
            self.encoder.append((down, blocks(name, depth, c, heads)))
        self.decoder = []
        for s, (c, depth, heads) in enumerate(zip(dec, config["dec_depths"], config["dec_heads"])):
            name = f"dec.dec{s}"
            coarse = dec[s + 1] if s + 1 < len(dec) else enc[-1]
            up = [
                Linear(w, f"{name}.up.proj.0", coarse, c),
                BatchNormGelu(w, f"{name}.up.proj.1", c),
                Linear(w, f"{name}.up.proj_skip.0", enc[s], c),
                BatchNormGelu(w, f"{name}.up.proj_skip.1", c),
            ]
            self.decoder.append((up, blocks(name, depth, c, heads)))
        self.head = Linear(w, "seg_head", dec[0], config["classes"]) if config["classes"] else None

    @torch.inference_mode()
    def __call__(self, grid, feat):
        """Features (language, before normalisation) or logits of every voxel."""
        cloud = Cloud.of(grid)
        x = self.stem_norm(self.stem(feat, cloud))
        cloud.maps.pop(5)
        skips = []
        for down, blocks in self.encoder:
            if down is not None:
                proj, norm = down
                coarse, cluster, counts = cloud.pool()
                y = proj(x)
                sums = y.new_zeros(len(counts), y.shape[1]).index_add_(0, cluster, y)
                skips.append((x, cloud, cluster))
                x, cloud = norm(sums / counts.unsqueeze(1)), coarse
            for block in blocks:
                x = block(x, cloud)
        for up, blocks in reversed(self.decoder):
            fine, cloud, cluster = skips.pop()
            proj, norm, proj_skip, norm_skip = up
            skip = norm_skip(proj_skip(fine))
            x = skip + norm(proj(x)).index_select(0, cluster)
            # The weights were trained with a first convolution that sees the skip branch alone.
            for i, block in enumerate(blocks):
                x = block(x, cloud, skip if i == 0 else None)
        return self.head(x) if self.head else x


# ---- Programs. ----


def check(network, config, golden):
    """Compares with numbers of the original implementation; fails beyond 1 % of the largest."""
    from safetensors.numpy import load_file

    stored = load_file(golden)
    grid = torch.from_numpy(stored["in.grid_coord"])
    got = network(grid, torch.from_numpy(stored["in.feat"]))
    results = []
    if config["classes"]:
        results.append(("out.logits", got.numpy(), stored["out.logits"]))
    else:
        rows = got[torch.from_numpy(stored["out.feat.rows"])]
        results.append(("out.feat", rows.numpy(), stored["out.feat"]))
        results.append(("out.feat.rownorm", got.norm(dim=1).numpy(), stored["out.feat.rownorm"]))
        unit_rows = F.normalize(rows, dim=1).numpy()
        results.append(("out.feat_normalized", unit_rows, stored["out.feat_normalized"]))
    worst = 0.0
    for name, got, expected in results:
        error, scale = np.abs(got - expected).max(), np.abs(expected).max()
        worst = max(worst, error / scale)
        print(f"{name}: largest difference {error:.2e}, largest value {scale:.2e}")
    print(f"largest relative difference {worst:.1e}")
    sys.exit(0 if worst <= 1e-2 else 1)


def load(scene, config):
    grid = torch.from_numpy(np.load(f"{scene}_grid_i32.npy").astype(np.int64))
    feat = np.load(f"{scene}_feat11_f32.npy")
    if config["in_channels"] == 14:
        normals = unit("normal", 3 * len(feat), 0).reshape(-1, 3)
        feat = np.concatenate([feat, normals], axis=1)
    return grid.to(DEVICE), place(torch.from_numpy(feat))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", choices=CONFIGS, default="language")
    parser.add_argument("--input", help="start of …_grid_i32.npy and …_feat11_f32.npy")
    parser.add_argument("--check", metavar="GOLDEN", help="compare with a reference file instead")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seed", type=int, default=20240, help="of the weights")
    parser.add_argument("--device", default="cpu", help="such as cuda:0")
    parser.add_argument("--precision", choices=["f32", "bf16"], default="f32")
    args = parser.parse_args()
    global DEVICE, DTYPE
    DEVICE, DTYPE = args.device, {"f32": torch.float32, "bf16": torch.bfloat16}[args.precision]
    torch.set_default_device(DEVICE)
    if bool(args.input) == bool(args.check):
        parser.error("give either --input or --check")
    torch.set_num_threads(args.threads)
    config = CONFIGS[args.config]
    network = Network(config, HashedWeights(args.seed, config["prefix"]))
    if args.check:
        check(network, config, args.check)
    grid, feat = load(args.input, config)
    print(f"torch {torch.__version__}, {args.threads} threads, {args.config}, {len(grid)} voxels")
    # One run warms up caches and the allocator.
    network(grid, feat)
    synchronize()
    seconds = []
    for _ in range(args.runs):
        gc.collect()
        start = time.perf_counter()
        network(grid, feat)
        synchronize()
        seconds.append(time.perf_counter() - start)
    if DEVICE != "cpu":
        print(f"peak of the device {torch.cuda.max_memory_allocated() / (1 << 30):.2f} GiB")
    # Linux counts in kibibytes.
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << 20)
    print(f"best {min(seconds):.3f} s, median {statistics.median(seconds):.3f} s of {args.runs} runs")
    print(f"peak memory {peak:.2f} GiB")


if __name__ == "__main__":
    main()
