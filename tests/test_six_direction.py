"""The six-direction networks: training, checkpoints, ONNX."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from nbv_gym.agents import six_direction
from nbv_gym.agents.six_direction import LABELS, CheckpointError, SixDirectionPolicy
from nbv_gym.rust_env import Camera
from nbv_gym.training import dataset
from nbv_gym.training.cli import app
from nbv_gym.training.dataset import Spec, generate, load

runner = CliRunner()
#: Labels need only be counted, not good.
TINY: dict[str, Any] = {"views": 12, "width": 24, "height": 18, "resolution": 0.1, "per_scene": 1}


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("six") / "set"
    generate(Spec(**{**TINY, "views": 24}), folder)
    return folder


needs_torch = pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="torch is not installed")


@pytest.fixture(scope="session")
def trained(tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("torch")
    from nbv_gym.training.train_cnn import practical, train

    out = tmp_path_factory.mktemp("cnn")
    report = train(practical(data=str(tiny), out=str(out), epochs=1, folds=1, batch_size=8, torch_threads=1))
    assert report["parameters"] > 300_000 and len(report["folds"]) == 1
    return out


def test_scores_by_hand() -> None:
    from nbv_gym.training.train_cnn import score

    logits = np.array([[3.0, 2, 1, 0, 0, 0], [0, 1, 3, 2, 0, 0]])
    gain = np.array([[4, 9, 0, 0, 0, 0], [0, 0, 6, 0, 0, 0]], dtype=np.int32)
    scores = score(logits, np.array([1, 2]), gain)
    assert (scores.accuracy, scores.top2) == (0.5, 1.0)
    assert scores.gain_share == pytest.approx((4 + 6) / (9 + 6))
    assert scores.confusion[1][0] == scores.confusion[2][2] == 1 and np.sum(scores.confusion) == 2
    likely = np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
    assert scores.loss == pytest.approx(-np.log([likely[0, 1], likely[1, 2]]).mean())


@needs_torch
def test_one_epoch_learns_and_writes(trained: Path) -> None:
    report = json.loads((trained / "report.json").read_text())
    scores = report["folds"][0]["validation"]
    assert np.sum(scores["confusion"]) == report["folds"][0]["views"]["validation"]
    text = (trained / "report.md").read_text()
    assert "validation accuracy" in text and "64.3 %" in text
    assert (trained / "fold-0" / "last.pt").exists()


@needs_torch
@pytest.mark.parametrize("device", ["cpu", "cuda"])
@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_training_goes_on_where_it_stopped(precision: str, device: str, tiny: Path, tmp_path: Path) -> None:
    import torch

    from nbv_gym.training.train_cnn import Fold, practical

    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("torch sees no CUDA device")
    data = load(tiny)
    inputs = six_direction.network_input(torch.from_numpy(data.depth.astype(np.float32) / 1000.0), 4.0, 64).to(device)

    def fold(out: str, **changes: Any) -> Fold:
        given = {"data": str(tiny), "out": str(tmp_path / out), "epochs": 3, "batch_size": 8, "precision": precision, "device": device}
        return Fold(practical(**{**given, **changes}), data, inputs, 0)

    torch.set_num_threads(1)
    whole = fold("whole")
    heard: list[float] = []
    whole.run_epoch(heard.append)
    whole.run_epoch(heard.append)
    assert heard == sorted(heard) and 1.0 in heard and heard[-1] == 2.0
    assert {value.dtype for value in whole.network.parameters()} == {torch.float32}
    # A fold seeds torch's own stream, too (dropout).
    first = fold("cut")
    first.run_epoch()
    first.save()
    second = fold("cut")
    second.resume()
    assert second.epoch == 1
    second.run_epoch()
    for a, b in zip(whole.network.state_dict().values(), second.network.state_dict().values(), strict=True):
        assert torch.equal(a, b)
    for other in ({"soft": 0.25}, {"precision": "bfloat16" if precision == "float32" else "float32"}):
        with pytest.raises(ValueError, match="other arguments"):
            fold("cut", **other).resume()


@needs_torch
def test_a_state_is_on_the_disk_before_it_replaces_the_last(tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    from nbv_gym.training.train_cnn import Fold, practical

    fold = Fold(practical(data=str(tiny), out=str(tmp_path), torch_threads=1), load(tiny), torch.zeros(24, 1, 64, 64), 0)
    last = tmp_path / "fold-0" / "last.pt"
    fold.save()
    before = last.read_bytes()
    fold.epoch = 1

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        fold.save()
    assert last.read_bytes() == before
    assert [path.name for path in last.parent.iterdir()] == ["last.pt"]


@needs_torch
def test_a_damaged_state_is_named(trained: Path, tiny: Path, tmp_path: Path) -> None:
    import torch

    last = tmp_path / "fold-0" / "last.pt"
    last.parent.mkdir()
    whole = (trained / "fold-0" / "last.pt").read_bytes()
    arguments = [
        "train",
        "cnn",
        "--data",
        str(tiny),
        "--out",
        str(tmp_path),
        "--epochs",
        "1",
        "--folds",
        "1",
        "--batch-size",
        "8",
        "--resume",
    ]

    def refused() -> str:
        done = runner.invoke(app, arguments)
        assert done.exit_code == 2 and isinstance(done.exception, SystemExit), done.output
        text = "".join(done.output.split())
        assert str(last) in text
        return text

    for content in (b"", b"junk", whole[: len(whole) // 2], whole[:-1]):
        last.write_bytes(content)
        assert "notacheckpoint,orcutshort" in refused()
    shutil.copy(trained / "fold-0" / "six_direction_small.pt", last)
    assert "notthestateofatraining,itlacksargs,epoch,history," in refused()
    last.write_bytes(whole)
    state = torch.load(last, weights_only=True)
    torch.save([1, 2], last)
    assert "itlacks" in refused()
    for change in ({"args": "{"}, {"args": "[]"}, {"rng": "{}"}, {"epoch": "two"}, {"network": {}}, {"optimiser": {}}, {"torch_rng": 1}):
        torch.save({**state, **change}, last)
        assert "last.pt:damaged(" in refused(), change


@needs_torch
def test_a_training_goes_on_with_more_folds_and_epochs(tiny: Path, tmp_path: Path) -> None:
    import torch

    from nbv_gym.training.train_cnn import practical, train

    def run(out: str, **changes: Any) -> dict[str, Any]:
        given = {"data": str(tiny), "out": str(tmp_path / out), "epochs": 1, "folds": 1, "batch_size": 8, "torch_threads": 1}
        return train(practical(**{**given, **changes}))["folds"]  # type: ignore[no-any-return]

    whole = run("whole", epochs=2, folds=2, cosine=False)
    run("grown", cosine=False)
    run("grown", cosine=False, folds=2, resume=True)
    assert run("grown", cosine=False, epochs=2, folds=2, resume=True) == whole
    for fold in ("fold-0", "fold-1"):
        a, b = (torch.load(tmp_path / out / fold / "last.pt", weights_only=True)["network"] for out in ("whole", "grown"))
        assert all(torch.equal(a[key], b[key]) for key in a)
    with pytest.raises(ValueError, match=r"last\.pt: 2 epochs are over, more than the 1 "):
        run("grown", cosine=False, resume=True)
    # What differs is named, and nothing else.
    with pytest.raises(
        ValueError, match=r"last\.pt: training with other arguments \(epochs: 2 there, 3 now, cosine: False there, True now\)"
    ):
        run("grown", epochs=3, resume=True)
    with pytest.raises(ValueError, match=r"other arguments \(soft: 0\.5 there, 0\.25 now\)"):
        run("grown", cosine=False, soft=0.25, epochs=9, resume=True)


@needs_torch
def test_a_training_that_diverges_keeps_its_last_good_epoch(tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    from nbv_gym.training.train_cnn import Fold, practical, train

    epoch_of = Fold.run_epoch

    def diverging(fold: Fold, step: Any = None) -> float:
        if fold.epoch == 1:
            fold.optimiser.param_groups[0]["lr"] = 1e30
            fold.args.learning_rate = 1e30
        return epoch_of(fold, step)

    monkeypatch.setattr(Fold, "run_epoch", diverging)
    with pytest.raises(RuntimeError, match="fold 0, epoch 2: the loss is not finite"):
        train(practical(data=str(tiny), out=str(tmp_path), epochs=3, folds=2, batch_size=8, cosine=False, torch_threads=1))
    state = torch.load(tmp_path / "fold-0" / "last.pt", weights_only=True)
    assert state["epoch"] == 1
    assert all(torch.isfinite(value).all() for value in state["network"].values())
    assert not (tmp_path / "report.json").exists() and not (tmp_path / "fold-0" / "six_direction_small.pt").exists()


@pytest.mark.parametrize("name", ["learning_rate", "momentum", "weight_decay", "soft", "temperature", "smoothing", "validation"])
@pytest.mark.parametrize("value", [float("inf"), float("nan"), -1.0])
def test_bad_settings_of_a_training_are_named(name: str, value: float) -> None:
    from nbv_gym.training.train_cnn import practical

    with pytest.raises(ValueError, match=f"{name} must .*, got {value}"):
        practical(**{name: value})


@needs_torch
def test_a_training_does_not_go_on_with_more_data(trained: Path, tiny: Path, tmp_path: Path) -> None:
    from nbv_gym.training.train_cnn import practical, train

    grown, out = tmp_path / "set", tmp_path / "out"
    shutil.copytree(tiny, grown)
    shutil.copytree(trained, out)
    same = {"data": str(grown), "out": str(out), "epochs": 1, "folds": 1, "batch_size": 8, "torch_threads": 1, "resume": True}
    train(practical(**same))
    generate(Spec(**{**TINY, "views": 30}), grown)
    with pytest.raises(ValueError, match="other arguments"):
        train(practical(**same))
    with pytest.raises(ValueError, match="float16"):
        practical(precision="float16")


@needs_torch
def test_a_checkpoint_comes_back(trained: Path, tiny: Path) -> None:
    import torch

    path = trained / "fold-0" / "six_direction_small.pt"
    name, network, far, facts = six_direction.load_checkpoint(path)
    assert (name, far, facts["digest"]) == ("small", 4.0, load(tiny).digest)
    depth = load(tiny).depth.astype(np.float32) / 1000.0
    policy = SixDirectionPolicy.load(path)
    shares = policy.probabilities(depth)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0)
    with torch.inference_mode():
        logits = network(six_direction.network_input(torch.from_numpy(depth), far, 64)).double()
    np.testing.assert_allclose(shares, np.asarray(torch.softmax(logits, 1)))
    camera = Camera(24, 18, hfov=1.0)
    assert policy.direction(depth[0], camera) == shares[0].argmax()
    with pytest.raises(ValueError, match="shape"):
        policy.direction(depth[0].T, camera)
    # Nothing measured, and nothing met.
    assert np.isfinite(policy.probabilities(np.array([np.zeros((18, 24)), np.full((18, 24), np.inf)], dtype=np.float32))).all()


@needs_torch
def test_weights_beyond_float16_are_not_kept(tmp_path: Path) -> None:
    import torch

    network = six_direction.architecture("small").build()
    with torch.no_grad():
        network[0].weight[0] = 1e6
    path = tmp_path / "net.pt"
    with pytest.raises(ValueError, match=r"net\.pt: .* 0\.weight"):
        six_direction.save_checkpoint(path, "small", network, 4.0, {"half": True})
    assert not path.exists()
    six_direction.save_checkpoint(path, "small", network, 4.0, {})


@needs_torch
def test_bad_checkpoints_are_named(trained: Path, tmp_path: Path) -> None:
    import torch

    good = trained / "fold-0" / "six_direction_small.pt"
    bad = tmp_path / "bad.pt"
    whole = good.read_bytes()
    for cut in (0, 100, len(whole) // 2, len(whole) - 1):
        bad.write_bytes(whole[:cut])
        with pytest.raises(CheckpointError, match=r"bad.pt: not a checkpoint, or cut short"):
            six_direction.load_checkpoint(bad)
    for text in (b"junk", b"not weights\n", b"k", b"{}"):
        bad.write_bytes(text)
        with pytest.raises(CheckpointError, match=r"bad.pt: not a checkpoint"):
            six_direction.load_checkpoint(bad)
    with pytest.raises(FileNotFoundError):
        six_direction.load_checkpoint(tmp_path / "none.pt")
    with pytest.raises(CheckpointError, match="'small', not 'alexnet'"):
        six_direction.load_checkpoint(good, "alexnet")
    content = torch.load(good, weights_only=True)
    for change, message in [
        ({"network": "alexnet"}, "do not fit the network 'alexnet'"),
        ({"network": "vgg"}, "'vgg'; known are small, alexnet"),
        ({"labels": LABELS[:4]}, "4 classes"),
        ({"layout": 99}, "layout 99"),
        ({"state": {}}, "do not fit"),
    ]:
        torch.save({**content, **change}, bad)
        with pytest.raises(CheckpointError, match=message):
            six_direction.load_checkpoint(bad)
    torch.save([1, 2], bad)
    with pytest.raises(CheckpointError, match="layout 'list'"):
        six_direction.load_checkpoint(bad)


@needs_torch
def test_onnx_gives_the_same_answers(trained: Path, tiny: Path, tmp_path: Path) -> None:
    pytest.importorskip("onnx")
    runtime = pytest.importorskip("onnxruntime")
    import torch

    from nbv_gym.training.train_cnn import export_onnx

    path = trained / "fold-0" / "six_direction_small.pt"
    export_onnx(path, tmp_path / "net.onnx")
    _, network, far, _ = six_direction.load_checkpoint(path)
    inputs = six_direction.network_input(torch.from_numpy(load(tiny).depth.astype(np.float32) / 1000.0), far, 64)
    with torch.inference_mode():
        expected = network(inputs).numpy()
    (logits,) = runtime.InferenceSession(str(tmp_path / "net.onnx")).run(["logits"], {"depth": inputs.numpy()})
    np.testing.assert_allclose(logits, expected, atol=1e-4)


@needs_torch
def test_where_onnx_goes_is_looked_at_before_training(tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from nbv_gym.training import train_cnn

    def untrained(*_: Any) -> None:
        raise ValueError("it trains")

    monkeypatch.setattr(train_cnn, "train", untrained)
    (tmp_path / "file").touch()
    for onnx, text in [("file/net.onnx", "file"), (".", "a folder, name a file"), ("new/folder/net.onnx", "it trains")]:
        done = runner.invoke(app, ["train", "cnn", "--data", str(tiny), "--onnx", str(tmp_path / onnx)])
        assert done.exit_code == 2 and text in done.output.replace("\n", "")
        assert ("it trains" in done.output) == onnx.startswith("new")
    assert (tmp_path / "new" / "folder").is_dir()


@needs_torch
def test_onnx_is_written_whole_or_not_at_all(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    from nbv_gym.training.train_cnn import export_onnx

    def torn(network: Any, inputs: Any, path: str, **_: Any) -> None:
        Path(path).write_bytes(b"half")
        raise RuntimeError("no space left")

    monkeypatch.setattr(torch.onnx, "export", torn)
    (tmp_path / "net.onnx").write_bytes(b"old")
    with pytest.raises(RuntimeError, match="no space left"):
        export_onnx(trained / "fold-0" / "six_direction_small.pt", tmp_path / "net.onnx")
    assert (tmp_path / "net.onnx").read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["net.onnx"]


@needs_torch
def test_both_networks_take_images_and_name_six_directions() -> None:
    import torch

    for name, parameters in [("small", 0.9e6), ("alexnet", 60e6)]:
        network = six_direction.architecture(name).build().eval()
        size = six_direction.architecture(name).size
        with torch.inference_mode():
            assert network(torch.zeros(1, 1, size, size)).shape == (1, 6)
        assert 0.5 * parameters < sum(p.numel() for p in network.parameters()) < parameters
    with pytest.raises(ValueError, match="small, alexnet"):
        six_direction.architecture("vgg")


@needs_torch
def test_the_weights_that_come_along_know_their_rooms() -> None:
    """New rooms, with the data set's own recipe: far above chance."""
    policy = SixDirectionPolicy.load()
    assert six_direction.WEIGHTS.stat().st_size < 5_000_000
    spec = Spec(seed=77, first=900, per_scene=2)
    units = [dataset.make_unit(spec, unit) for unit in range(2)]
    depth = np.concatenate([unit["depth"] for unit in units]).astype(np.float32) / 1000.0
    label = np.concatenate([unit["label"] for unit in units])
    accuracy = float((policy.probabilities(depth).argmax(axis=1) == label).mean())
    assert len(label) >= 16 and accuracy > 0.35, accuracy
