within Daest.Blocks;
package Math "Operations on signals"
end Math;
