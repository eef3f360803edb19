"""Pure computation: from contacts to hypotheses, and from hypotheses to the next approach."""
