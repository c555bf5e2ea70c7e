within Daest.Effects;
package General "Effects that need no domain"
end General;
