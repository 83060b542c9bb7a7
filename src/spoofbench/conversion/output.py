"""What became of logs, for people and for machines."""

from collections.abc import Sequence
from typing import Any

from spoofbench.conversion.batch import ConversionOutcome
from spoofbench.conversion.contract import Ledger
from spoofbench.formatting import share_percent

_MARKS = {"not recognised": "not recognised", "failed": "failed"}


def as_rows(outcomes: Sequence[ConversionOutcome]) -> list[dict[str, Any]]:
    """Return the outcomes for machines, ledgers in full; what does not apply is None."""
    return [
        {
            "source": str(outcome.job.source),
            "recording": str(outcome.job.target) if outcome.ledger else None,
            "status": outcome.status,
            "reason": outcome.reason,
            "ignored_options": list(outcome.ignored),
            "ledger": outcome.ledger.as_dict() if outcome.ledger else None,
        }
        for outcome in outcomes
    ]


def as_table(outcomes: Sequence[ConversionOutcome]) -> list[str]:
    """Return a line per log: rows, used and skipped share, the name of the recording or why there
    is none, the largest loss.
    """
    lines = [f"{'rows':>11} {'used %':>7} {'skip %':>7}  recording"]
    for outcome in outcomes:
        if outcome.ledger is None:
            lines.append(
                f"{'-':>11} {'-':>7} {'-':>7}  {outcome.job.source}: {_MARKS[outcome.status]}"
            )
            continue
        lines.append(
            f"{outcome.ledger.rows.total():>11,} {_shares(outcome.ledger)}  "
            f"{outcome.job.target}{_largest_loss(outcome.ledger)}"
        )
    ignored = sorted({name for outcome in outcomes for name in outcome.ignored})
    for name in ignored:
        sources = [str(outcome.job.source) for outcome in outcomes if name in outcome.ignored]
        lines.append(
            f"option {name!r} does not exist for {len(sources)} of them: "
            f"{', '.join(sources[:3])}{', ...' if sources[3:] else ''}"
        )
    return lines


def _shares(ledger: Ledger) -> str:
    share = ledger.skipped_share
    return (
        f"{'-':>7} {'-':>7}"
        if share is None
        else f"{share_percent(1 - share):>7} {share_percent(share):>7}"
    )


def _largest_loss(ledger: Ledger) -> str:
    return f"; skipped most: {ledger.reasons.most_common(1)[0][0]}" if ledger.reasons else ""
