within Daest;
package Effects "Physical effects that a model may lack, to be connected or put in series"
  import Daest.Units.SI;
  annotation(Documentation(info = "An effect is a component that is connected to a model, put in series with one of its connectors, or put
behind an input or before an output. Its parameters of role size make it vanish at their null value; those of
role shape tell its form; those of role sharpness round a kink and are not estimated; those of role given are
taken from the component that it belongs to. A grid holds values worth trying, in multiples of the largest
magnitude of the variable named by of, or as they are where there is none.

A class of one's own becomes an effect by annotation(__Daest(effect = true, attach = ..., law = ...))."));
end Effects;
