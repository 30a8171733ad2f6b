"""Data alone: parameters, configurations, worlds, scenarios, and machines (presets) by name."""
