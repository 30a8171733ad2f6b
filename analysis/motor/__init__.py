"""The motor FMU alone: its step responses, and its speed loop as control theory sees it."""
