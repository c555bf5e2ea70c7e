within Daest.Hydraulic;
package Components "Storage and transport of liquid"
end Components;
