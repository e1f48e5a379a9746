import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from test_portfolio import constant, make

from damage import damaged, damaged_bytes, refusals
from mbtl.errors import InvalidInput, StorageError
from mbtl.portfolio import MLPPolicy, load_portfolio
from mbtl.portfolio.archive import load_policy


def rewritten(folder, change):
    """The portfolio with a manifest that `change` has edited."""
    path = folder / "portfolio.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest))
    return folder


def custom(saved):
    return make(sources=(0,), returns=np.ones((1, 5)), in_memory={}, policy_folders=(saved,),
                policy_format="custom")  # fmt: skip


# ---- what a stranger could have put in --------------------------------------------------------


def test_a_file_that_the_manifest_does_not_list_is_refused(tmp_path):
    """It would be read instead of the one whose hash was checked."""
    saved = tmp_path / "sb3"
    saved.mkdir()
    (saved / "model.zip").write_bytes(b"zip")
    folder = custom(saved).save(tmp_path / "p")
    constant(1).save(folder / "policies" / "source-0000")
    with pytest.raises(StorageError, match=r"only what its manifest lists.*policy\.json"):
        load_portfolio(folder)


@pytest.mark.parametrize(
    "name", ["/etc/hostname", "../x", "a/../../x", "C:\\x", "..\\x", "\\x", "C:x", "", ".", "a\0b"]
)
def test_a_path_that_leads_out_is_refused_on_every_system(tmp_path, name):
    folder = make().save(tmp_path / "p")
    with pytest.raises(StorageError, match="inside its own folder"):
        load_portfolio(rewritten(folder, lambda m: m["policies"].insert(0, name)))
    other = rewritten(make().save(tmp_path / "q"), lambda m: m["files"].update({name: ""}))
    with pytest.raises(StorageError, match="inside its own folder"):
        load_portfolio(other)


def test_links_and_pipes_are_neither_copied_nor_read(tmp_path):
    secret = tmp_path / "id_rsa"
    secret.write_text("secret")
    saved = tmp_path / "policy"
    for make_bad in (
        lambda place: place.symlink_to(secret),
        lambda place: place.symlink_to(tmp_path),  # of a folder
        os.mkfifo,
    ):
        saved.mkdir()
        (saved / "own.txt").write_text("7")
        make_bad(saved / "extra")
        with pytest.raises(StorageError, match=r"got the (link|pipe or device) .*extra"):
            custom(saved).save(tmp_path / "p")
        assert not (tmp_path / "p").exists()
        with pytest.raises(StorageError, match=r"got the (link|pipe or device) .*extra"):
            load_policy(saved, "mlp", None)
        shutil.rmtree(saved)
    folder = make().save(tmp_path / "p")
    os.mkfifo(folder / "pipe")
    with pytest.raises(StorageError, match="got the pipe or device"):
        load_portfolio(folder)


def test_a_zip_that_can_run_code_needs_trust(tmp_path, monkeypatch):
    saved = tmp_path / "sb3"
    saved.mkdir()
    (saved / "model.zip").write_bytes(b"zip")
    folder = custom(saved).save(tmp_path / "p")
    rewritten(folder, lambda m: m.update(policy_format="sb3"))
    read = []
    monkeypatch.setattr("mbtl.trainers.load_sb3", lambda place: read.append(place) or "model")
    with pytest.raises(InvalidInput, match=r"can run code.*pass trust=True \(--trust\)"):
        load_portfolio(folder).policy(0)
    assert not read
    assert load_portfolio(folder, trust=True).policy(0) == "model"
    assert load_portfolio(folder, load=lambda place: place.name).policy(0) == "source-0000"


# ---- damage -----------------------------------------------------------------------------------


def used(folder):
    """Everything that is done with a portfolio."""
    portfolio = load_portfolio(folder)
    portfolio.explain({"length": 0.7})
    portfolio.routing.route, portfolio.value, repr(portfolio)
    for i in range(len(portfolio)):
        portfolio.policy(i).predict(np.zeros(1))
    return portfolio


def test_any_damage_to_a_manifest_gets_a_sentence(tmp_path):
    folder = make().save(tmp_path / "p")
    path = folder / "portfolio.json"
    whole = json.loads(path.read_text())

    def attempt(seed):
        path.write_text(json.dumps(damaged(whole, seed)))
        used(folder)

    assert refusals(attempt, 100) > 50


@pytest.mark.parametrize("text", ["[" * 100_000, "null", "[]", "{", '{"kind": "mbtl portfolio"}'])
def test_a_manifest_of_another_form_gets_a_sentence(tmp_path, text):
    folder = make().save(tmp_path / "p")
    (folder / "portfolio.json").write_text(text)
    with pytest.raises(StorageError):
        load_portfolio(folder)


def test_any_damage_to_a_policy_gets_a_sentence(tmp_path):
    constant(1).save(tmp_path)
    record, weights = ((tmp_path / name).read_bytes() for name in ("policy.json", "weights.npz"))

    def attempt(seed):
        (tmp_path / "policy.json").write_text(json.dumps(damaged(json.loads(record), seed)))
        bad = damaged_bytes(weights, seed) if seed % 2 else weights
        (tmp_path / "weights.npz").write_bytes(bad)
        MLPPolicy.load(tmp_path).predict(np.zeros(1))

    assert refusals(attempt, 120) > 60


# ---- an interrupt while the old one is replaced -----------------------------------------------


class Killed(BaseException):
    """Stands for SIGKILL: nothing that follows it, clean-up included, is done."""


def interrupted(monkeypatch, error, step):
    """Raise `error` before the `step`-th change of the file system; of a kill, before all later."""
    count = 0

    def stopping(change):
        def wrapped(*args, **kwargs):
            nonlocal count
            count += 1
            if count == step or (count > step and error is Killed):
                raise error
            return change(*args, **kwargs)

        return wrapped

    for name in ("rename", "unlink", "rmdir", "mkdir"):
        monkeypatch.setattr(Path, name, stopping(getattr(Path, name)))
    monkeypatch.setattr(shutil, "rmtree", stopping(shutil.rmtree))
    monkeypatch.setattr(os, "fsync", stopping(os.fsync))
    return lambda: count


@pytest.mark.parametrize("error", [KeyboardInterrupt, Killed])
def test_an_interrupt_at_any_step_leaves_the_old_portfolio_or_the_new_one(
    tmp_path, error, monkeypatch
):
    monkeypatch.setattr(os, "fsync", lambda handle: None)  # a test need not wait for the disk
    one = {"returns": np.ones((1, 5)), "in_memory": {0: constant(1)}}
    step, new = 0, make(sources=(1,), **one)
    while True:
        step += 1
        folder = make(sources=(0,), **one).save(tmp_path / str(step) / "p")
        with pytest.MonkeyPatch.context() as patch:
            steps = interrupted(patch, error, step)
            try:
                new.save(folder, overwrite=True)
            except (KeyboardInterrupt, Killed):
                pass
            else:
                if steps() < step:
                    break
        assert used(folder).sources in ((0,), (1,)), step
        with pytest.raises(InvalidInput, match="already holds a portfolio"):
            new.save(folder)
        new.save(folder, overwrite=True)
        assert used(folder).sources == (1,)
        left = [path.name for path in folder.parent.iterdir() if ".partial-" not in path.name]
        assert left == ["p"], step  # what a kill left half built may stay
    assert step > 10


def test_files_are_on_the_disk_before_the_folder_has_its_name(tmp_path, monkeypatch):
    done, fsync, rename = [], os.fsync, Path.rename
    monkeypatch.setattr(os, "fsync", lambda handle: done.append("sync") or fsync(handle))
    monkeypatch.setattr(Path, "rename", lambda self, to: done.append("rename") or rename(self, to))
    make().save(tmp_path / "p")
    files = 2 + 2 * 2  # manifest and returns; record and weights of two policies
    assert done.index("rename") >= files
    assert done[-1] == "sync"  # of the name itself
