"""Sources of the vibration motor FMU; `fmus.build` compiles them."""
