"""What was taken for what: one row per true and inferred activity, with the time spent so."""

import dataframely as dy


class Confusions(dy.Schema):
    """One row per method × subject × true activity × inferred activity that occurred."""

    method = dy.String(primary_key=True, description="Which method: rule_tree, decision_tree, …")
    subject = dy.String(primary_key=True, description="Episode, or 'all'")
    truth = dy.String(primary_key=True, description="True activity")
    predicted = dy.String(primary_key=True, description="Inferred activity")
    duration_ns = dy.Int64(
        min=0, description="Time for which it was so, hands added up", metadata={"unit": "ns"}
    )
    share = dy.Float64(min=0.0, max=1.0, description="Share of the true activity's time")
