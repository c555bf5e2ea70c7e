within Daest.Effects.General.Interfaces;
partial model PartialLearnedLoad "Load as a curve over a variable of the model, times the sign of another one"
  constant Real x_knots[:] = {-1, 1} "Values of x at the knots, rising; in the unit of x";
  constant Real period = 0
    "Period of the curve in the unit of x, greater than the distance of the outermost knots; 0: none";
  parameter Real y[size(x_knots, 1)] = zeros(size(x_knots, 1)) "Load at the knots"
    annotation(__Daest(estimate = true));
  parameter Real s_s(min = 1e-12) = 0.01 "Value of s over which its sign changes, in the unit of s";
  input Real x "Variable of the model that the load is a curve over";
  input Real s = 1 "Variable of the model whose sign multiplies the curve (default: always positive)";
  Real v "x, brought into one period of the curve";
  Real load "Load that enters the component";
protected
  constant Integer n = size(x_knots, 1) "Number of knots";
equation
  v = if period > 0 then x_knots[1] + noEvent(mod(x - x_knots[1], period)) else x;
  load = tanh(s/s_s)*(y[1] + sum(
    (y[k + 1] - y[k])*noEvent(max(0, min(1, (v - x_knots[k])/(x_knots[k + 1] - x_knots[k])))) for k in 1:n - 1)
    + (if period > 0 then
      (y[1] - y[n])*noEvent(max(0, min(1, (v - x_knots[n])/(x_knots[1] + period - x_knots[n])))) else 0));
end PartialLearnedLoad;
