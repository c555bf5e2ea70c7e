within Daest.Effects;
package Electrical "Effects in circuits"
end Electrical;
