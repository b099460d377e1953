"""Where the pages of a lab say that a run is suspect."""

import pytest
from toy_lab import labbook, unsealed
from toy_records import records
from toy_web import Read, client, make


@pytest.mark.slow
def test_every_page_with_the_run_says_that_it_is_suspect(tmp_path):
    make(tmp_path, orifices="[24]", replicates=2, count=200)
    lab = tmp_path / "lab"
    key = records(lab)["orifice 24 mm", 2].run_key
    pages = ("/", "/runs", "/card/toy-study", "/study/toy-study", "/study/toy-study/point/1", f"/run/{key[:16]}")
    assert not [page for page in pages if "suspect" in Read(client(lab).get(page).text).words]
    file = lab / "runs" / key / "run.json"
    file.write_text(unsealed(file.read_text()).replace('"overlap": null', '"overlap": 0.2'))
    labbook("reindex", "--lab", lab)
    somebody = client(lab)
    assert not [page for page in pages if "suspect" not in Read(somebody.get(page).text).words]
    why = "grains overlap by 0.2 d, more than 0.1 d"
    for page in ("/study/toy-study/point/1", f"/run/{key[:16]}"):
        assert why in Read(somebody.get(page).text).words
    assert "left out of means" in Read(somebody.get("/study/toy-study/point/1").text).words
    (row,) = somebody.get("/runs.json?outcome=suspect").json()["runs"]
    assert (row["run_key"], row["suspect"]) == (key, why)
