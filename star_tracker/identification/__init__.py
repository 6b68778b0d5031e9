"""Which star is which: votes, candidates, evidence, the judge and the labels."""
