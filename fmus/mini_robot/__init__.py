"""Sources of the robot FMU; `fmus.build` compiles them."""
