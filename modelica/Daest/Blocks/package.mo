within Daest;
package Blocks "Signals"
end Blocks;
