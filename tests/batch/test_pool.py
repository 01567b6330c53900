import os
from pathlib import Path

from dying_work import work
from instok3d.batch.executor import ProcessDiedError
from instok3d.batch.pool import Processes


def test_in_one_process_errors_are_outcomes(tmp_path: Path):
    found = list(Processes().run(work, [(number, tmp_path) for number in (1, 3, 2)]))
    assert [each.answer for each in found] == [(1, os.getpid()), None, (2, os.getpid())]
    assert str(found[1].error) == "three is refused"
    assert list(Processes(2).run(work, [])) == []


def test_a_process_that_dies_takes_no_other_job_with_it(tmp_path: Path):
    jobs = [(number, tmp_path) for number in range(8)]
    found = {each.job[0]: each for each in Processes(2).run(work, jobs)}
    assert sorted(found) == list(range(8))
    assert {number for number, each in found.items() if each.error is not None} == {3, 5}
    assert isinstance(found[5].error, ProcessDiedError)
    assert found[4].answer is not None
    assert os.getpid() not in {each.answer[1] for each in found.values() if each.answer}
