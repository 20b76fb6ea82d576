from snakemake.output_index import OutputIndex
from snakemake.scheduling.job_scheduler import JobScheduler

from snakemake_logger_plugin_roadsight import producers, stopping
from snakemake_logger_plugin_roadsight.patching import replace_method


class Owner:
    def known(self):
        """Say one."""
        return 1


def two(owner):
    return 2


def test_what_is_expected_is_replaced_once(capsys):
    for _ in range(2):
        replace_method(Owner, "known", "def known(self):\n    return 1\n", two, "slow")
    assert Owner().known() == 2 and capsys.readouterr().err == ""


def test_what_is_not_expected_stays_and_is_said(capsys):
    replace_method(Owner, "other", "def other(self):\n    return 1\n", two, "lists are slow")
    assert not hasattr(Owner, "other")
    assert "has another Owner.other: lists are slow" in capsys.readouterr().err


def test_the_tested_snakemake_is_what_the_changes_expect(capsys):
    producers.remember_producers()
    stopping.let_stops_through()
    assert OutputIndex.match_producers is producers.match_producers
    assert JobScheduler.exit_gracefully is stopping.exit_gracefully
    assert capsys.readouterr().err == ""
