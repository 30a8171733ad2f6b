model VibrationMotor "Vibration motor: DC motor with eccentric mass, Coulomb friction that sticks, and PI speed loop"
  // The readable specification of the FMU; motor.h is compared with it at random states. Names are
  // those of variables.toml, equation numbers those of the paper, units SI and radians.
  // Everything is inlined and free of library types, so that small Modelica compilers read it too.

  parameter Real m = 0.00021 "motor eccentric mass in kg";
  parameter Real r = 0.00177 "eccentricity of the rotating mass in m";
  parameter Real K_T = 3.64e-4 "torque constant in N.m/A";
  parameter Real J = 2.67e-9 "eccentric load's moment of inertia in kg.m2";
  parameter Real R = 10.7 "motor electrical resistance in Ohm";
  parameter Real b = 2.94e-9 "viscous friction in N.m.s/rad";
  parameter Real c = 1.34e-5 "Coulomb friction torque in N.m";
  parameter Real g = 9.81 "gravitational acceleration in m/s2";
  parameter Real K_p = 0.015 "proportional gain in V.s/rad";
  parameter Real K_i = 0.025 "integral gain in V/rad";
  parameter Real V_s_max = 3.0 "maximum input voltage in V";
  parameter Real theta_start = 0.0 "angle of the eccentric mass at the start in rad";
  parameter Real omega_start = 0.0 "speed of the shaft at the start in rad/s";
  parameter Boolean closed_loop = true "true: PI speed loop of Eq. 14; false: V_in drives the motor";

  input Real omega_des "desired speed of the shaft in rad/s";
  input Real d "external disturbance torque on the shaft in N.m";
  input Real omega_noise "measurement noise on the speed in rad/s";
  input Real V_in "voltage command in open loop in V";

  output Real theta(start = theta_start, fixed = true) "angle of the eccentric mass in rad, 0 when it hangs straight down";
  output Real omega(start = omega_start, fixed = true) "speed of the shaft in rad/s";
  output Real omega_dot "acceleration of the shaft in rad/s2";
  output Real V_s "voltage at the motor in V";
  output Real i "armature current in A";

  Real integral(start = 0.0, fixed = true) "integral of the speed error in rad";
  Real e "speed error that the controller sees in rad/s";
  Real u "voltage command before saturation in V";
  Real drive "every torque on the shaft but Coulomb friction in N.m";
  Real friction "Coulomb friction torque in N.m";

equation
  e = omega_des - (omega + omega_noise);
  // Eq. (14)
  u = if closed_loop then K_p*e + K_i*integral else V_in;
  V_s = if u > V_s_max then V_s_max elseif u < -V_s_max then -V_s_max else u;
  // Conditional integration: the integral holds while the error would push the command further
  // beyond the limit.
  der(integral) = if not closed_loop then 0.0 elseif u > V_s_max and e > 0.0 then 0.0 elseif u < -V_s_max and e < 0.0 then 0.0 else e;

  // Eq. (13) with the current in place of the voltage and the back-EMF
  i = (V_s - K_T*omega)/R;
  drive = K_T*i - b*omega - m*g*r*sin(theta) + d;
  // sgn(0) is set-valued: at rest friction balances the drive up to c
  friction = if omega > 0.0 then c elseif omega < 0.0 then -c elseif drive > c then c elseif drive < -c then -c else drive;
  omega_dot = (drive - friction)/J;
  der(theta) = omega;
  der(omega) = omega_dot;
end VibrationMotor;
