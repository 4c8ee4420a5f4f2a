"""The machine around the programs: signals, budgets, files, compiled code kept, plain YAML, what computed a result."""
