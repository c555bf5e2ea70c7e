within Daest;
package Constants "Constants of mathematics and nature"
  final constant Real pi(unit = "1") = 3.14159265358979323846 "Ratio of a circle's circumference to its diameter";
  final constant Daest.Units.SI.Acceleration g_n = 9.80665 "Standard acceleration of gravity on earth";
  final constant Real T_zero(unit = "degC") = -273.15 "Absolute zero temperature";
end Constants;
