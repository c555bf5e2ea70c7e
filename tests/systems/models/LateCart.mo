package LateCart
  model Base "A cart on a spring with drag, driven by a force that comes late"
    parameter Real m(unit = "kg") = 2;
    parameter Real k(unit = "N/m") = 150;
    parameter Real a(unit = "N.s2/m2") = 5;
    parameter Real T(unit = "s", min = 0) = 0.013 "Dead time";
    input Real u(unit = "N");
    output Real y(unit = "m");
    Real s(unit = "m", start = 0.01, fixed = true);
    Real v(unit = "m/s");
    Real late(unit = "N");
  equation
    late = delay(u, T);
    der(s) = v;
    m*der(v) = late - k*s - a*v*sqrt(v*v + 1e-4);
    y = s;
  end Base;

  model Accelerated "Whose sensor shows the force at once"
    extends Base;
    output Real acc(unit = "m/s2");
  equation
    acc = (late - k*s)/m;
  end Accelerated;

  model Twice "Which feels two sums of what the force was"
    extends Base;
    Real w(unit = "N.s");
  equation
    der(w) = delay(u, T) - delay(2*u, 1.5*T) - w*abs(w);
  end Twice;

  model Behind "Whose sensor is late, not its drive"
    parameter Real m(unit = "kg") = 2;
    parameter Real k(unit = "N/m") = 150;
    parameter Real T(unit = "s", min = 0) = 0.013;
    input Real u(unit = "N");
    output Real y(unit = "m");
    Real s(unit = "m");
    Real v(unit = "m/s");
  equation
    der(s) = v;
    m*der(v) = u - k*s - 5*v*sqrt(v*v + 1e-4);
    y = delay(s, T);
  end Behind;

  model Direct "Whose late sensor shows the force at once"
    extends Base;
    output Real acc(unit = "m/s2");
  equation
    acc = delay((u - k*s)/m, 2*T);
  end Direct;
end LateCart;
