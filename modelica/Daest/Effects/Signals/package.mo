within Daest.Effects;
package Signals "Effects on inputs, outputs and other signals"
end Signals;
