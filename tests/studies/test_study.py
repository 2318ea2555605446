import pytest

from drake_quad import InputError, load_scenario, read_study, run_monte_carlo
from drake_quad.studies.study import read_record


@pytest.mark.parametrize("text", ["- samples\n", "samples: 3\nseed: 1\nduration: 2.0\n", "seed\n"])
def test_what_is_no_record_of_a_study_is_refused(tmp_path, text):
    (tmp_path / "study.yaml").write_text(text)
    with pytest.raises(InputError, match="is not the record of a study"):
        read_record(tmp_path)


def test_what_is_read_was_not_flown_just_now(tmp_path):
    scenario = load_scenario("diagrams/hover.yaml", ["duration=0.1"])
    assert run_monte_carlo(scenario, 2, folder=tmp_path, num_workers=1).flown_time > 0.0
    assert read_study(tmp_path).flown_time == 0.0
