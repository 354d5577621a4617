"""Labels from Python have the bits of the files that the program writes."""

import json
import threading

import numpy as np
import pytest
from conftest import arrays, program

import scenesplat
from scenesplat import Error, Network, Scene


def same_bits(a, b):
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def test_segment(demo, room, network):
    found = scenesplat.segment(room, network)
    assert same_bits(found.labels, np.load(demo / "labels.npy"))
    assert same_bits(found.scores, np.load(demo / "scores.npy"))
    assert found.names == json.loads((demo / "classes.json").read_text())
    counts = found.counts()
    assert sum(counts.values()) == len(found) == len(room)
    assert counts["wall"] == (found.labels == found.names.index("wall")).sum()


def test_segment_by_flags(demo, room, tmp_path):
    flags = ["--vote-k=8", "--without=wall,door", "--min-score=0.2", "--surfaces=off", "--setting=voxel=0.08"]
    done = program("segment", demo / "room.ply", "--out", tmp_path / "o", "--quiet", *flags)
    assert done.returncode == 0, done.stderr
    found = scenesplat.segment(
        room,
        Network.load(setting="voxel=0.08"),
        vote_k=8,
        without=["wall", "door"],
        min_score=0.2,
        surfaces="off",
    )
    assert same_bits(found.labels, np.load(tmp_path / "o/labels.npy"))
    assert same_bits(found.scores, np.load(tmp_path / "o/scores.npy"))
    assert found.names.index("wall") not in found.labels


def test_rows_that_are_left_out_are_in_the_files(room, network, tmp_path):
    path = tmp_path / "a.ply"
    room.save(path)
    data = bytearray(path.read_bytes())
    # The first position of row 2 of the file.
    head, row = data.index(b"end_header\n") + 11, (len(data) - data.index(b"end_header\n") - 11) // len(room)
    data[head + 2 * row : head + 2 * row + 4] = np.float32(np.nan).tobytes()
    path.write_bytes(data)
    done = program("segment", path, "--out", tmp_path / "o", "--quiet")
    assert done.returncode == 0, done.stderr
    with pytest.warns(UserWarning, match="1 left out"):
        scene = Scene.open(path)
    found = scenesplat.segment(scene, network)
    file = np.load(tmp_path / "o/labels.npy")
    assert len(file) == len(room) == len(found) + 1 and file[2] == -1
    assert same_bits(scenesplat.to_source_rows(scene, found.labels, -1), file)
    with pytest.raises(ValueError, match="values: expected"):
        scenesplat.to_source_rows(scene, found.labels[1:], -1)


def test_features_query_and_objects(demo, room, network, tmp_path):
    ply = demo / "room.ply"
    for words in (["features", ply], ["query", ply, "red chair"], ["objects", ply]):
        done = program(*words, "--out", tmp_path / words[0], "--quiet")
        assert done.returncode == 0, done.stderr
    features = scenesplat.features(room, network)
    assert same_bits(np.asarray(features), np.load(tmp_path / "features/features.npy"))
    found = scenesplat.query(room, "red chair", network)
    assert same_bits(found.scores, np.load(tmp_path / "query/scores.npy"))
    assert (found.selected == np.load(tmp_path / "query/selection.npy")).all()
    objects = scenesplat.objects(room, network)
    assert same_bits(objects.instances, np.load(tmp_path / "objects/instances.npy"))
    assert objects.table == json.loads((tmp_path / "objects/objects.json").read_text())


def test_features_of_others_are_labelled(room, network, tmp_path):
    features = np.asarray(scenesplat.features(room, network))
    np.save(tmp_path / "f.npy", features)
    a = scenesplat.segment(room, features=features, text="vocabulary")
    b = scenesplat.segment(room, features=tmp_path / "f.npy", text="vocabulary")
    assert same_bits(a.labels, b.labels)
    with pytest.raises(ValueError, match=r"features: expected \[N, D\]"):
        scenesplat.segment(room, features=features[0])


def test_a_scene_of_arrays_is_labelled_as_its_file(room, network):
    copy = Scene.from_arrays(
        means=room.means,
        rotations=room.rotations,
        log_scales=room.log_scales,
        opacity_logits=room.opacity_logits,
        sh=room.sh,
    )
    a = scenesplat.segment(copy, network, up="+z")
    assert same_bits(a.labels, scenesplat.segment(room, network, up="+z").labels)
    assert same_bits(a.labels, scenesplat.segment(copy, network, up=[0, 0, 1]).labels)


def test_inspect_align_and_evaluate(demo, room, network, tmp_path):
    done = program("inspect", demo / "room.ply", "--no-sheet", "--verbose", "--json", tmp_path / "i.json")
    assert done.returncode == 0, done.stderr
    seen = scenesplat.inspect(room)
    file = json.loads((tmp_path / "i.json").read_text())
    assert seen.report == file and seen.text in done.stdout
    aligned = scenesplat.align(room, network)
    assert aligned.report == file["alignment"]
    assert np.abs(aligned.rotation @ aligned.rotation.T - np.eye(3)).max() < 1e-12
    words = ["evaluate", "synthetic:1:7", "--out", tmp_path / "e", "--quiet"]
    done = program(*words)
    assert done.returncode == 0, done.stderr
    figures = scenesplat.evaluate("synthetic:1:7", network)
    file = json.loads((tmp_path / "e/evaluation.json").read_text())
    assert all(file[name] == value for name, value in figures.items())
    assert 0.5 < figures["f_miou"] < 1


def test_scenes_are_evaluated_by_their_labels(room, network):
    labelled = dict(
        means=room.means,
        rotations=room.rotations,
        log_scales=room.log_scales,
        opacity_logits=room.opacity_logits,
        sh=room.sh,
    )
    found = scenesplat.segment(room, network, up="+z")
    with pytest.raises((Error, ValueError), match="label"):
        scenesplat.evaluate(Scene.from_arrays(**labelled), network)
    own = Scene.from_arrays(**labelled, segment=found.labels)
    figures = scenesplat.evaluate([own], network, up="+z")
    assert figures["miou"] > 0.99 and figures["scenes"] == 1


def test_progress_is_told_and_ends_the_work(room, network):
    steps = []
    scenesplat.segment(room, network, progress=lambda step, done: steps.append((step, done)))
    shares = [done for step, done in steps if step.startswith("network") and done is not None]
    assert shares == sorted(shares) and shares and 0 <= shares[0] <= shares[-1] <= 1

    def fail(step, done):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        scenesplat.segment(room, network, progress=fail)


def test_threads_share_a_network(room, network):
    expected = scenesplat.segment(room, network).labels
    found = [None] * 3

    def work(i):
        found[i] = scenesplat.segment(room, network).labels

    threads = [threading.Thread(target=work, args=(i,)) for i in range(3)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert all(same_bits(labels, expected) for labels in found)


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda s: scenesplat.segment(s, vote_k=-1), ValueError, "vote-k"),
        (lambda s: scenesplat.segment(s, vote_k=True), ValueError, "vote-k"),
        (lambda s: scenesplat.segment(s, strange="no"), ValueError, "strange"),
        (lambda s: scenesplat.segment(s, text="none.pt"), Exception, "none.pt"),
        (lambda s: scenesplat.segment(s, without=["a,b"]), ValueError, "comma"),
        (lambda s: scenesplat.segment(s, without=["walll"]), Exception, "wall"),
        (lambda s: scenesplat.segment(s, colour=1), TypeError, "colour"),
        (lambda s: scenesplat.segment(s, "net"), TypeError, "Network.load"),
        (lambda s: scenesplat.query(s, "zzzqq"), ValueError, "zzzqq"),
        (lambda s: scenesplat.query(s, "--out"), Exception, "out"),
        (lambda s: Network.load("none.pth"), Exception, "none.pth"),
        (lambda s: Network.load(precision="f3"), ValueError, "precision"),
        (lambda s: scenesplat.evaluate([]), ValueError, "at least one"),
    ],
)
def test_wrong_use_is_an_exception(call, error, text, room):
    with pytest.raises(error, match=text):
        call(room)


def test_errors_have_the_words_of_the_program(demo, room, tmp_path):
    done = program("query", demo / "room.ply", "zzzqq", "--out", tmp_path / "q")
    assert done.returncode == 2
    with pytest.raises(ValueError) as error:
        scenesplat.query(room, "zzzqq")
    assert f"error: {error.value}" in done.stderr


def test_warnings_are_python_warnings(random):
    scene = Scene.from_arrays(**arrays(random, n=400))
    with pytest.warns(UserWarning, match="SEEDED WEIGHTS"):
        seeded = Network.load("seeded:1", config="tiny")
    assert seeded.has_random_weights and seeded.out_channels == 64
    assert scenesplat.features(scene, seeded, as_is=True).values.shape[1] == 64
