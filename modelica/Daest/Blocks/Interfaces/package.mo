within Daest.Blocks;
package Interfaces "Signal connectors"
end Interfaces;
