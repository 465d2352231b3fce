"""benchmark.ablation switches mechanisms off, one at a time, and on again."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmark import ablation
from benchmark.ablation import (
    Difference,
    differences,
    Job,
    KINDS,
    MECHANISMS,
    NOTHING,
    size_of,
    without,
)

METHOD = 'dynamic_factor'


@pytest.mark.long
def test_every_mechanism_is_off_for_its_motion_alone():
    """What was patched is as before, and motions are the same again."""
    before = without(NOTHING, 'moving', 62, METHOD)
    off = without(MECHANISMS[0], 'moving', 62, METHOD)
    assert MECHANISMS[0].name == 'evasive plan' and off != before
    assert without(NOTHING, 'moving', 62, METHOD) == before


@pytest.mark.long
@pytest.mark.parametrize('kind', KINDS)
def test_motions_of_each_kind_are_judged(kind):
    figures = without(NOTHING, kind, 700_001, METHOD)
    assert all(np.isfinite(value) for value in figures.values())
    assert figures['violations'] == 0.0


def test_lines_and_constants_are_counted():
    lines, constants = size_of(MECHANISMS[0])
    assert 500 < lines < 700 and 10 < constants < 60
    assert size_of(NOTHING) == (0, 0)


def test_a_difference_counts_if_all_blocks_agree():
    found = {Job(mechanism, 'static', block, seed, METHOD): {'hits': value}
             for mechanism, values in ((-1, (0.0, 1.0)), (0, (1.0, 1.0)), (1, (1.0, 0.0)))
             for block, value in enumerate(values) for seed in (block,)}
    assert differences(found, 0) == [Difference('static: hits', 0.5, (1.0, 0.0))]
    assert not differences(found, 0)[0].counts and not differences(found, 1)[0].counts
    assert Difference('', 0.0, (-1.0, -0.1)).counts and not Difference('', 0.0, (0.0,)).counts


@pytest.mark.long
def test_the_command_writes_what_it_found(tmp_path, capsys):
    file = tmp_path / 'found.json'
    assert ablation.main(['--without', 'damping', '--kind', 'static', '--blocks', '1',
                          '--share', '0', '--jobs', '1', '--json', str(file)]) == 0
    found = json.loads(file.read_text())['damping']
    figure = found['differences']['static: joint path']
    assert figure['all'] > 0.1 and len(figure['blocks']) == 1
    assert 'damping' in capsys.readouterr().out
    with pytest.raises(SystemExit):
        ablation.main(['--without', 'nothing'])
