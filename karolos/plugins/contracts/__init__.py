"""The promises of plugins, checked by a plugin's own tests, by `karolos plugins check`, and by karolos's tests.

    from karolos.plugins.contracts import check

    def test_it_keeps_what_agents_promise():
        check("agents", "my_agent")

Each promise is a function that raises AssertionError with one line; `cases` names them one by one.
"""

from .case import Candidate, Case, candidate
from .checking import KINDS, cases, check, results

__all__ = ["KINDS", "Candidate", "Case", "candidate", "cases", "check", "results"]
