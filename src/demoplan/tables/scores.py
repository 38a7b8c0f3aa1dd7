"""How good it is: one row per subject and metric, with n and an interval."""

import dataframely as dy


class Scores(dy.Schema):
    """One row per scored subject × metric."""

    suite = dy.String(primary_key=True, description="What was evaluated: segmentation, planning, …")
    method = dy.String(primary_key=True, description="Which method: rule_tree, decision_tree, …")
    subject = dy.String(primary_key=True, description="Episode, domain or 'all'")
    metric = dy.String(primary_key=True, description="Metric's name, with its unit if it has one")
    value = dy.Float64(nullable=True, description="The figure")
    n = dy.Int64(min=0, description="Observations behind it")
    low = dy.Float64(nullable=True, description="Lower end of the 95 % interval")
    high = dy.Float64(nullable=True, description="Upper end of the 95 % interval")
    detail = dy.String(nullable=True, description="Cause of a failure, or the split that was left out")
