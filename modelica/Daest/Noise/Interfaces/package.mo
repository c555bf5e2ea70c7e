within Daest.Noise;
package Interfaces "Partial models of noise"
end Interfaces;
