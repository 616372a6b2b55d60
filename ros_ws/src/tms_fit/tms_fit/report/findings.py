"""What speaks against the model: tests of the residuals, and rival explanations of the same response."""

from __future__ import annotations

from tms_fit.diagnostics.hypothesis_tests import HypothesisTest
from tms_fit.diagnostics.residual_tests import ResidualDiagnostics, probability
from tms_fit.report.element import Element, element, table
from tms_fit.report.rounding import NONE, as_sentence, decimals, fixed, number, significant


def hypotheses_table(verdicts: tuple[HypothesisTest, ...]) -> Element | None:
    """The hypotheses with what the data say, those rejected first in words; None without any."""
    if not verdicts:
        return None
    rejected = [one.sentence for one in verdicts if one.rejected]
    summary = element("ul", *(element("li", as_sentence(text)) for text in rejected))
    rows: list[list[Element | str]] = []
    for one in verdicts:
        places = decimals(one.std)
        rows.append(
            [
                one.hypothesis,
                "rejected"
                if one.rejected
                else "not rejected"
                if one.p_value == one.p_value
                else "can't tell",
                probability(one.p_value) if one.p_value == one.p_value else NONE,
                one.parameter.replace("_", " "),
                number(one.assumed, places),
                number(one.value, places),
                fixed(one.std, places),
                significant(one.delta_aic),
                significant(one.delta_bic),
            ]
        )
    head = ["hypothesis", "verdict", "probability", "parameter [SI]", "assumed", "found", "standard error"]
    return element(
        "section",
        element("h3", "Hypotheses"),
        element(
            "p",
            "Each assumption of the model, tested against the model without it. A negative change of AIC or"
            " BIC speaks for giving the assumption up.",
        ),
        summary if rejected else element("p", "None of them is rejected."),
        table([*head, "change of AIC", "change of BIC"], rows, class_="hypotheses"),
    )


def criticism_table(criticism: ResidualDiagnostics) -> Element | None:
    """Tests of the residuals with a sentence each; None where there were too few samples."""
    if not criticism.tests:
        return None
    rows: list[list[Element | str]] = [
        [
            one.name.replace("_", " "),
            one.channel.replace("_", " "),
            "passed" if one.passed else "failed",
            significant(one.statistic),
            probability(one.p_value),
            as_sentence(one.sentence),
        ]
        for one in criticism.tests
    ]
    shares = ", ".join(
        f"{fixed(value, 1)} % of the {name.replace('_', ' ')}"
        for name, value in criticism.fit_percent.items()
    )
    failed = sum(not one.passed for one in criticism.tests)
    verdict = (
        f"{failed} of {len(criticism.tests)} tests speak against the model or its noise."
        if failed
        else as_sentence(criticism.verdict)
    )
    head = ["test", "channel", "result", "statistic", "probability", "in words"]
    return element(
        "section",
        element("h3", "What the residuals say"),
        element("p", f"{verdict} Fit (NRMSE): {shares}. {as_sentence(criticism.size)}"),
        table(head, rows, class_="criticism"),
    )
