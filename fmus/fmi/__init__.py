"""Parts that all FMUs share: shims of the standards, units, the frame of their documentation."""
