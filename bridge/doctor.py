"""Is this vehicle set up right? All checks as one table, and their report.

`survey` collects, `doctor_checks` judges, each one by itself; a report is good if nothing in it is a FAIL.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass

from gatar_edge.bridge import doctor_checks as of
from gatar_edge.bridge.profiles import Profile
from gatar_edge.bridge.survey import Facts
from gatar_edge.bridge.verdict import Finding, Level

# of what is on the link, whether there is a vehicle or not
FIRST: dict[str, Callable[[Facts], Finding]] = {
    "heartbeat": of.check_heartbeat,
    "profile": of.check_profile,
}
# of the vehicle that was found; None where a check does not apply
CHECKS: dict[str, Callable[[Facts, Profile], Finding | None]] = {
    "answers": of.check_answers,
    "version": of.check_version,
    "position": of.check_position,
    "home": of.check_home,
    "origin": of.check_origin,
    "place": of.check_place,
    "fence": of.check_fence,
    "companion loss": of.check_companion_loss,
    "rates": of.check_rates,
    "mission": of.check_mission,
    "signing": of.check_signing,
    "clock": of.check_clock,
    "company": of.check_company,
    "battery": of.check_battery,
    "armed": of.check_armed,
}


@dataclass(frozen=True, slots=True)
class Report:
    """The findings by the name of their check."""

    findings: dict[str, Finding]

    @property
    def good(self) -> bool:
        """Whether nothing failed."""
        return all(finding.level is not Level.FAIL for finding in self.findings.values())

    def count(self, level: Level) -> int:
        """How many findings are of this level."""
        return sum(finding.level is level for finding in self.findings.values())

    def as_list(self) -> list[dict[str, str]]:
        """For JSON."""
        return [{"check": name, **asdict(finding)} for name, finding in self.findings.items()]


def examine(facts: Facts) -> Report:
    """Run all checks that apply."""
    findings = {name: check(facts) for name, check in FIRST.items()}
    if facts.profile is not None:
        for name, check in CHECKS.items():
            finding = check(facts, facts.profile)
            if finding is not None:
                findings[name] = finding
    return Report(findings)
