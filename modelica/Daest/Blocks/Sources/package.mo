within Daest.Blocks;
package Sources "Sources of signals"
end Sources;
