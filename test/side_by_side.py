"""All tests on two cores: those of live processes, and beside them all others.

Live processes share ROS domains, ports and the attention of a core, so their tests run one after
another. The others only compute, and step back behind them: not so far that other work on the
machine leaves them nothing. Arguments go to both runs of pytest.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile

_NOTHING_COLLECTED = 5


def main(arguments: list[str]) -> int:
    """Run both; print the live tests as they go, then the others. Return the exit status."""
    pytest = [sys.executable, '-m', 'pytest', *arguments]
    with tempfile.TemporaryFile('w+') as said:
        others = subprocess.Popen(['nice', '-n', '5', *pytest, '-m', 'not live'], stdout=said,
                                  stderr=subprocess.STDOUT)
        try:
            live = subprocess.run([*pytest, '-m', 'live']).returncode
            ends = {live, others.wait()}
        finally:
            others.kill()
        said.seek(0)
        sys.stdout.write(said.read())
    return int(bool(ends - {0, _NOTHING_COLLECTED}) or ends == {_NOTHING_COLLECTED})


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
