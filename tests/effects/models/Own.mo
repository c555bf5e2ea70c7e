package Own "A model with connectors of its own and a component made of components"
  connector Shaft "Shaft with the variables of the Standard Library"
    Real phi(unit = "rad") "Angle";
    flow Real tau(unit = "N.m") "Torque";
  end Shaft;

  model Body "Rotating body with one shaft"
    Shaft end_a "Shaft";
    parameter Real J(unit = "kg.m2") = 0.3 "Inertia";
    Real w(unit = "rad/s", start = 0) "Speed";
  equation
    w = der(end_a.phi);
    J*der(w) = end_a.tau;
  end Body;

  model Twist "Elastic shaft"
    Shaft end_a "One end";
    Shaft end_b "Other end";
    parameter Real k(unit = "N.m/rad") = 5 "Stiffness";
  equation
    end_a.tau + end_b.tau = 0;
    end_b.tau = k*(end_b.phi - end_a.phi);
  end Twist;

  model Train "Body with an elastic shaft"
    Shaft out "End of the shaft";
    Body body "Body";
    Twist twist "Shaft";
  equation
    connect(body.end_a, twist.end_a);
    connect(twist.end_b, out);
  end Train;

  model Machine "Train with a load"
    input Real u(unit = "N.m", start = 0) "Torque on the load";
    output Real y(unit = "rad") "Angle of the load";
    Train train "Train";
    Body load(J = 0.7) "Load";
    Real w(unit = "rad/s", start = 0) "Speed of a flywheel without connectors";
  equation
    connect(train.out, load.end_a);
    0.2*der(w) = u - 0.1*w;
    y = load.end_a.phi;
  end Machine;
end Own;
