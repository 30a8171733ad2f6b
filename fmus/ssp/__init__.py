"""Systems of the project's FMUs for other tools: System Structure and Parameterization (SSP)."""
