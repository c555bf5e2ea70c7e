within Daest.Mechanics.Translational;
package Sources "Sources of force and velocity"
end Sources;
