"""How policies hold in worlds that they were not trained for: the table of docs/robustness.md."""
