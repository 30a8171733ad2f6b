/* FMI 3.0 shim of MiniRobot, after fmi3.c and fmi3_cosimulation.c: the types that it lacks. */
NO_VARIABLES(Int64)
NO_VARIABLES(UInt64)

NOT_OFFERED(fmi3EnterConfigurationMode)
NOT_OFFERED(fmi3ExitConfigurationMode)
