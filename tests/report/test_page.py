"""What is in a page before any browser draws it: numbers, texts, size."""

import base64
import gzip
import json
import re

import numpy as np
import pytest

import mbtl
from flat import created, ran, told
from mbtl.errors import InvalidInput
from mbtl.report import of_study, page, write_page
from mbtl.report.content import content
from mbtl.report.packing import packed, quantised
from mbtl.selectors import Proposal
from mbtl.zoo.benchmark import TransferMatrix
from mbtl.zoo.benchmark.subject import of_matrix
from scripted import Scripted

N = 20
SPACE = mbtl.ContextSpace.grid({mbtl.Log("mass", 0.1, 10.0, unit="kg"): N})


def near(space, source):
    return 0.9 - 0.5 * np.linalg.norm(space.unit - space.unit[source], axis=1)


def study_on(space=SPACE, picks=3, problem="toy"):
    study = created(space, budget=6, bounds=(0.0, 1.0), problem=problem, strategy="mbtl")
    return told(study, lambda source: near(space, source), picks, seconds=60.0)


def unpacked(text):
    """As the page does it."""
    data = gzip.decompress(base64.b64decode(text))
    length = int.from_bytes(data[:4], "little")
    start = -(-(4 + length) // 8) * 8
    types = {"f8": "<f8", "i4": "<i4", "u1": "<u1", "u2": "<u2"}

    def revive(value):
        if isinstance(value, list):
            return [revive(item) for item in value]
        if not isinstance(value, dict):
            return value
        if "$" not in value:
            return {key: revive(item) for key, item in value.items()}
        size = int(np.prod(value["shape"]))
        kind = np.dtype(types[value["type"]])
        flat = np.frombuffer(data, kind, size, start + value["$"])
        if kind.kind == "u":
            top = np.iinfo(kind).max - 1
            scaled = value["low"] + flat * ((value["high"] - value["low"]) / top)
            flat = np.where(flat > top, np.nan, scaled)
        return flat.reshape(value["shape"])

    return revive(json.loads(data[4 : 4 + length]))


def items_of(text):
    return unpacked(re.search(r'id="data">([^<]*)<', text)[1])


def test_what_is_packed_comes_back():
    rng = np.random.default_rng(0)
    table = rng.normal(size=(7, 5))
    table[2, 3] = np.nan
    found = unpacked(packed([{"t": table, "x": np.array([0.1, 0.2]), "i": np.arange(3), "s": "é"}]))
    assert found[0]["x"].tolist() == [0.1, 0.2]
    assert found[0]["i"].tolist() == [0, 1, 2]
    assert found[0]["s"] == "é"
    assert found[0]["t"] == pytest.approx(table, abs=1e-4, nan_ok=True)
    assert packed([float("nan")]) == packed([None])


def test_constant_and_empty_tables_are_quantised_without_a_warning():
    for value, code, lowest in ((np.nan, 65535, 0.0), (3.0, 0, 3.0)):
        codes, low, _ = quantised(np.full((2, 2), value))
        assert ((codes == code).all(), low) == (True, lowest)


def test_the_page_holds_the_numbers_of_the_study():
    study = study_on()
    (item,) = items_of(page([of_study(study)]))
    assert item["sources"] == list(study.history.sources)
    assert item["curve"]["values"] == pytest.approx(study.curve)
    assert item["served"]["performance"] == pytest.approx(study.routing.served)
    assert item["served"]["policy"].tolist() == study.routing.route.tolist()
    assert item["rows"] == pytest.approx(study.history.rows, abs=1e-4)
    assert item["reasons"] == [pick.reason for pick in study.trainings]
    assert item["axes"][0]["log"]
    assert item["steps"]["model"] == "mbtl"


def test_a_page_is_written_to_a_path_given_as_text_and_to_no_folder(tmp_path):
    subjects = [of_study(study_on(picks=1))]
    assert write_page(subjects, f"{tmp_path}/a/page.html").read_text().startswith("<!doctype html>")
    with pytest.raises(InvalidInput, match=r"is a folder; give .*report\.html"):
        write_page(subjects, tmp_path)


def test_no_score_is_shown_where_nothing_can_be_trained_any_more():
    study = study_on(picks=4)
    for j, gain in enumerate(content(of_study(study))["steps"]["gain"], 1):
        taken = np.isin(np.arange(N), study.history.sources[:j])
        assert np.isnan(gain[taken]).all()
        assert np.isfinite(gain[~taken]).all()


def test_the_runner_up_is_the_best_of_the_others():
    study = study_on(picks=3)
    served = content(of_study(study))["served"]
    rows = study.history.rows.copy()
    rows[served["policy"], np.arange(N)] = -np.inf
    assert served["runnerUpPerformance"] == pytest.approx(rows.max(axis=0))
    alone = content(of_study(study_on(picks=1)))["served"]
    assert (alone["runnerUp"] == -1).all()


def test_texts_can_be_read_without_scripts_and_names_are_no_markup():
    study = study_on(problem="<b>{{JS}}</b>", picks=2)
    study.fail(study.ask(), "no <luck>", traceback="line 1\nline 2")
    text = page([of_study(study)])
    assert "<h1>&lt;b&gt;{{JS}}&lt;/b&gt;</h1>" in text
    body = re.sub(r"<script.*?</script>", "", text, flags=re.S)
    for said in ("gained", "took 2.0 minutes", "1 training failed."):
        assert said in body
    assert "failed: no &lt;luck&gt;" in body
    assert "line 1\nline 2" in body
    assert not re.search(r"""(src|href)=["'](?!data:|#)""", text.split('id="data"')[0])


def test_a_page_begins_with_v_as_a_return_and_ends_in_what_to_do(tmp_path):
    study = created(
        SPACE, budget=2, bounds=(0.0, 200.0), problem="toy", strategy="mbtl",
        storage=tmp_path / "study.db", name="study",
    )  # fmt: skip
    told(study, lambda source: 200.0 * near(SPACE, source))
    study.ask()
    text = page([of_study(study)])
    v = study.value
    assert f'<p class="value">V = {v:.3f}</p><p>mean return {200 * v:.4g} over' in text
    worst = int(study.routing.served.argmin())
    listed = re.search(r"<h2>Served worst</h2>.*?</section>", text, re.DOTALL)[0]
    assert listed.index(SPACE.describe(SPACE.context(worst))) < listed.index("policy")
    assert listed.count("<tr>") == 6
    assert "policy_for" not in text  # there is no portfolio so far
    assert f"mbtl study show {tmp_path}" in text
    assert re.search(r"created&quot;: &quot;20\d\d-\d\d-\d\d \d\d:\d\d", text)


def test_a_study_without_rows_has_a_page_and_costs_are_said_where_they_are_counted():
    study = study_on(picks=0)
    text = page([of_study(study)])
    assert "No policy was trained yet." in text
    assert "0 episodes" not in text
    assert "in the unit of the study" not in text
    assert 'data-chart="' not in re.sub(r"<script.*?</script>", "", text, flags=re.S)
    study.tell(study.ask(), np.zeros(N), cost=2.5)
    assert "The trainings cost 2.5 in the unit of the study." in page([of_study(study)])


def matrix_on(space, sources=None, seeds=2):
    every = np.arange(space.n) if sources is None else sources
    away = np.linalg.norm(space.unit[every][:, None] - space.unit, axis=2)
    rows = 0.9 - 0.5 * away + 0.01 * np.random.default_rng(0).normal(size=(seeds, *away.shape))
    return TransferMatrix.of(rows, space=space, bounds=(0, 1), sources=sources, name="toy")


def test_a_matrix_of_fewer_sources_is_replayed_beside_others():
    matrix = matrix_on(SPACE, np.arange(0, N, 3))
    item = content(of_matrix(matrix, "mbtl", budget=4, seed=1))
    assert set(item["sources"]) <= set(matrix.sources)
    assert item["matrix"]["values"].shape == (7, N)
    assert {"Random", "Sequential Oracle", "specialists"} <= set(item["baselines"])
    assert item["curve"]["values"][-1] <= item["levels"]["Oracle Transfer"] + 1e-9


def test_a_matrix_of_900_contexts_that_is_all_noise_is_below_5_mb():
    from mbtl.report.html import _plotly
    from mbtl.report.packing import compressed

    table = np.random.default_rng(0).random((900, 900))
    steps = dict.fromkeys(("mean", "std", "gain", "served"), table[:15])
    data = packed([{"matrix": table, **steps}])
    assert len(data) + len(compressed(_plotly().encode())) < 4.9e6


def test_policies_of_several_contexts_and_tuned_copies_are_told_from_specialists():
    every = tuple(range(N))
    script = (
        Proposal(9, "all", sources=every, length=0.5),
        Proposal(9, "longer", sources=every, start=0, length=1.0),
        Proposal(3, "tuned", start=1, length=0.5),
        Proposal(3, "tuned on", start=2, length=1.0),
        Proposal(4, "from scratch"),
    )
    study = created(SPACE, budget=4, strategy=Scripted(script), bounds=(0.0, 1.0))

    def train(contexts, seed, *, start=None, length=None):
        return len(contexts)

    ran(study, train, lambda policy, contexts, seeds: np.full((len(contexts), 3), 0.5))
    found = content(of_study(study))
    assert found["kinds"] == ["several", "several", "tuned", "tuned", "specialist"]
