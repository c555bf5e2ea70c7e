within Daest.Mechanics.Rotational;
package Sources "Sources of torque and angular velocity"
end Sources;
