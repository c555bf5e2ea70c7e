within Daest.Electrical.Analog;
package Basic "Passive components and electromechanical converters"
end Basic;
