import pytest

from drake_quad import InputError
from drake_quad.analysis.monte_carlo.study import read_record


@pytest.mark.parametrize("text", ["- samples\n", "samples: 3\nseed: 1\nduration: 2.0\n", "seed\n"])
def test_what_is_no_record_of_a_study_is_refused(tmp_path, text):
    (tmp_path / "study.yaml").write_text(text)
    with pytest.raises(InputError, match="is not the record of a study"):
        read_record(tmp_path)
