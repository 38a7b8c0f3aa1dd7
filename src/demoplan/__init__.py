"""demoplan: from logged demonstrations of manipulation to planning domains, with proof."""

__version__ = "0.1.0"
