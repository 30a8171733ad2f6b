"""Sources of the FMU of an array of vibration motors; `fmus.build` compiles them."""
