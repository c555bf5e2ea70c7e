package Servo54 "A servo of separate components: 54 equations, 4 dynamic modes"
  connector Pin
    Real v(unit = "V");
    flow Real i(unit = "A");
  end Pin;

  connector Flange
    Real phi(unit = "rad");
    flow Real tau(unit = "N.m");
  end Flange;

  partial model TwoPin
    Pin p, n;
    Real v(unit = "V"), i(unit = "A");
  equation
    v = p.v - n.v;
    0 = p.i + n.i;
    i = p.i;
  end TwoPin;

  model Resistor
    extends TwoPin;
    parameter Real R(unit = "Ohm", min = 0) = 1 "resistance";
  equation
    R*i = v;
  end Resistor;

  model Source
    extends TwoPin;
    input Real V(unit = "V");
  equation
    v = V;
  end Source;

  model Ground
    Pin p;
  equation
    p.v = 0;
  end Ground;

  model EMF
    extends TwoPin;
    parameter Real k(unit = "N.m/A") = 1 "torque constant";
    Flange flange;
    Real w(unit = "rad/s");
  equation
    w = der(flange.phi);
    k*w = v;
    flange.tau = -k*i;
  end EMF;

  model Inertia
    Flange flange_a, flange_b;
    parameter Real J(unit = "kg.m2", min = 0) = 1 "moment of inertia";
    Real phi(unit = "rad"), w(unit = "rad/s"), a(unit = "rad/s2");
  equation
    phi = flange_a.phi;
    phi = flange_b.phi;
    w = der(phi);
    a = der(w);
    J*a = flange_a.tau + flange_b.tau;
  end Inertia;

  model IdealGear
    Flange flange_a, flange_b;
    parameter Real ratio = 1;
  equation
    flange_a.phi = ratio*flange_b.phi;
    0 = ratio*flange_a.tau + flange_b.tau;
  end IdealGear;

  partial model Compliant
    Flange flange_a, flange_b;
    Real phi_rel(unit = "rad"), tau(unit = "N.m");
  equation
    phi_rel = flange_b.phi - flange_a.phi;
    flange_b.tau = tau;
    flange_a.tau = -tau;
  end Compliant;

  model Spring
    extends Compliant;
    parameter Real c(unit = "N.m/rad") = 1 "stiffness";
  equation
    tau = c*phi_rel;
  end Spring;

  model Damper
    extends Compliant;
    parameter Real d(unit = "N.m.s/rad") = 1 "damping";
    Real w_rel(unit = "rad/s");
  equation
    w_rel = der(phi_rel);
    tau = d*w_rel;
  end Damper;

  model Servo "voltage to disc"
    input Real u(unit = "V", start = 0) "voltage";
    output Real omega(unit = "rad/s") = motor.w/30 "speed after the gear";
    output Real phi(unit = "rad") = disc.phi "angle of the disc";
    parameter Real J1(unit = "kg.m2") = 3.0e-6 "rotor inertia" annotation (__Daest(estimate = true, scale = "log"));
    Resistor resistor(R = 4.6);
    Source source(V = u);
    Ground ground;
    EMF emf(k = 0.06);
    Inertia motor(J = J1), disc(J = 3.66e-4);
    IdealGear gear(ratio = 30);
    Spring spring(c = 0.0362);
    Damper damper(d = 5.43e-4);
  equation
    connect(source.p, resistor.p);
    connect(resistor.n, emf.p);
    connect(emf.n, source.n);
    connect(ground.p, source.n);
    connect(emf.flange, motor.flange_a);
    connect(motor.flange_b, gear.flange_a);
    connect(gear.flange_b, spring.flange_a);
    connect(spring.flange_a, damper.flange_a);
    connect(spring.flange_b, disc.flange_a);
    connect(damper.flange_b, disc.flange_a);
  end Servo;
end Servo54;
