package HeatedServo "A motor whose parts have heat ports, as those of the Modelica Standard Library"
  connector Pin
    Real v(unit = "V");
    flow Real i(unit = "A");
  end Pin;
  connector HeatPort
    Real T(unit = "K");
    flow Real Q_flow(unit = "W");
  end HeatPort;
  model Resistor
    Pin p;
    Pin n;
    parameter Real R(unit = "Ohm") = 1;
    parameter Real T_ref(unit = "K") = 300.15;
    parameter Real alpha(unit = "1/K") = 0;
    parameter Boolean useHeatPort = false;
    parameter Real T(unit = "K") = T_ref;
    HeatPort heatPort(T = T_heatPort, Q_flow = -LossPower) if useHeatPort;
    Real v(unit = "V");
    Real i(unit = "A");
    Real R_actual(unit = "Ohm");
    Real LossPower(unit = "W");
    Real T_heatPort(unit = "K");
  equation
    if not useHeatPort then
      T_heatPort = T;
    end if;
    v = p.v - n.v;
    0 = p.i + n.i;
    i = p.i;
    R_actual = R*(1 + alpha*(T_heatPort - T_ref));
    v = R_actual*i;
    LossPower = v*i;
  end Resistor;
  model Source
    Pin p;
    input Real u(unit = "V");
  equation
    p.v = u;
  end Source;
  model Winding "An inductance and the voltage of a rotor, against ground"
    Pin p;
    parameter Real L(unit = "H") = 0.1;
    parameter Real k(unit = "N.m/A") = 0.5;
    parameter Real J(unit = "kg.m2") = 0.02;
    Real w(start = 0, fixed = true, unit = "rad/s");
  equation
    p.v = L*der(p.i) + k*w;
    J*der(w) = k*p.i;
  end Winding;
  model Circuit
    input Real u(start = 0, unit = "V");
    output Real y(unit = "rad/s") = winding.w;
    Source source(u = u);
    Resistor hot(R = 2, alpha = 0.004, T = 350);
    Resistor cold(R = 1);
    Winding winding;
  equation
    connect(source.p, hot.p);
    connect(hot.n, cold.p);
    connect(cold.n, winding.p);
  end Circuit;
  model Measured "The power of a resistor is an output"
    extends Circuit;
    output Real power(unit = "W") = hot.LossPower;
  end Measured;
end HeatedServo;
