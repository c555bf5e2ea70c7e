model SliderCrank "Crank, flexible connecting rod and slider, constraints on velocities: index 2 (Test Set for IVP Solvers 2.4)"
  constant Real pi = 3.1415927 "as published";
  constant Real Omega = 150 "speed of the crank";
  constant Real l1 = 0.15;
  constant Real l2 = 0.30;
  constant Real m2 = 0.151104;
  constant Real m3 = 0.075552;
  constant Real J1 = 0.002727;
  constant Real J2 = 0.0045339259;
  constant Real E = 0.20e12;
  constant Real b = 0.008;
  constant Real h = 0.008;
  constant Real rho = 7870;
  constant Real A = b*h*l2 "volume of the rod";
  constant Real m = rho*A;
  constant Real k = E*b*h/l2;
  Real phi1(start = 0, fixed = true);
  Real phi2(start = 0, fixed = true);
  Real x3(start = 0.450016933, fixed = true);
  Real q1(start = 0, fixed = true, nominal = 1e-4);
  Real q2(start = 0, fixed = true, nominal = 1e-5);
  Real q3(start = 1.03339863e-5, fixed = true, nominal = 1e-5);
  Real q4(start = 1.69327969e-5, fixed = true, nominal = 1e-5);
  Real w1(start = 150, nominal = 100);
  Real w2(start = -74.99576703969453, nominal = 100);
  Real v3(start = -2.68938672e-6, nominal = 10);
  Real u1(start = 0.444896112581599, fixed = true, nominal = 0.1);
  Real u2(start = 4.63433931923867e-3, fixed = true, nominal = 1e-2);
  Real u3(start = -1.78591076000055e-6, fixed = true, nominal = 1e-3);
  Real u4(start = -2.68938672e-6, fixed = true, nominal = 1e-3);
  Real s, c "sine and cosine of the angle between crank and rod";
  Real c1q, c2q, c12q, c1u, c2u, c12u "moments of the shape of the rod";
  Real M1q, M2q, M3q, M4q "mass matrix of the rod times q";
  Real K1q, K2q, K3q, K4q "stiffness matrix of the rod times q";
  Real B1u, B2u, B3u, B4u "matrix of the rotation times u";
  Real B1q, B2q, B3q, B4q "its transpose times q";
  Real g1, g2, g3, g4 "coupling of the bending and the rotation";
  Real lam1, lam2, lam3;
equation
  der(phi1) = w1;
  der(phi2) = w2;
  der(x3) = v3;
  der(q1) = u1;
  der(q2) = u2;
  der(q3) = u3;
  der(q4) = u4;
  s = sin(phi1 - phi2);
  c = cos(phi1 - phi2);
  c1q = A*(2/3*q3 + q4/6);
  c2q = A*2/pi*q1;
  c12q = l2*A*(q3/3 + q4/6);
  c1u = A*(2/3*u3 + u4/6);
  c2u = A*2/pi*u1;
  c12u = l2*A*(u3/3 + u4/6);
  M1q = m/2*q1;
  M2q = m/2*q2;
  M3q = m*(8*q3 + q4);
  M4q = m*(q3 + 2*q4);
  K1q = k*pi^4/24*(h/l2)^2*q1;
  K2q = k*pi^4*2/3*(h/l2)^2*q2;
  K3q = k*(16*q3 - 8*q4)/3;
  K4q = k*(-8*q3 + 7*q4)/3;
  B1u = A*(-16/pi^3*u3 + (8/pi^3 - 1/pi)*u4);
  B2u = A*0.5/pi*u4;
  B3u = A*16/pi^3*u1;
  B4u = A*(-(8/pi^3 - 1/pi)*u1 - 0.5/pi*u2);
  B1q = A*(16/pi^3*q3 - (8/pi^3 - 1/pi)*q4);
  B2q = -A*0.5/pi*q4;
  B3q = -A*16/pi^3*q1;
  B4q = A*((8/pi^3 - 1/pi)*q1 + 0.5/pi*q2);
  g1 = rho*(l2*A/pi + B1q);
  g2 = rho*(-l2*A*0.5/pi + B2q);
  g3 = rho*B3q;
  g4 = rho*B4q;
  (J1 + m2*l1^2)*der(w1) + (0.5*l1*l2*m2*c + rho*l1*(s*c2q + c*c1q))*der(w2)
    + rho*l1*(c*A*2/pi*der(u1) - s*A*(2/3*der(u3) + der(u4)/6))
    + l1*cos(phi1)*lam1 + l1*sin(phi1)*lam2 + lam3
    = -0.5*l1*l2*m2*w2^2*s + rho*l1*w2^2*(-s*c1q + c*c2q) - 2*rho*l1*w2*(c*c1u + s*c2u);
  (0.5*l1*l2*m2*c + rho*l1*(s*c2q + c*c1q))*der(w1)
    + (J2 + q1*M1q + q2*M2q + q3*M3q + q4*M4q + 2*rho*c12q)*der(w2)
    + g1*der(u1) + g2*der(u2) + g3*der(u3) + g4*der(u4)
    + (l2 + q4)*cos(phi2)*lam1 + (l2 + q4)*sin(phi2)*lam2
    = 0.5*l1*l2*m2*w1^2*s + rho*l1*w1^2*(s*c1q - c*c2q) - 2*rho*w2*c12u
    - 2*w2*(u1*M1q + u2*M2q + u3*M3q + u4*M4q) - rho*(u1*B1u + u2*B2u + u3*B3u + u4*B4u);
  m3*der(v3) + lam2 = 0;
  rho*l1*c*A*2/pi*der(w1) + g1*der(w2) + m/2*der(u1)
    = w2^2*M1q + rho*(l1*w1^2*s*A*2/pi + 2*w2*B1u) - K1q;
  g2*der(w2) + m/2*der(u2) = w2^2*M2q + 2*rho*w2*B2u - K2q;
  -rho*l1*s*A*2/3*der(w1) + g3*der(w2) + m*(8*der(u3) + der(u4))
    = w2^2*M3q + rho*(w2^2*l2*A/3 + l1*w1^2*c*A*2/3 + 2*w2*B3u) - K3q;
  -rho*l1*s*A/6*der(w1) + g4*der(w2) + m*(der(u3) + 2*der(u4)) + sin(phi2)*lam1 - cos(phi2)*lam2
    = w2^2*M4q + rho*(w2^2*l2*A/6 + l1*w1^2*c*A/6 + 2*w2*B4u) - K4q;
  0 = l1*cos(phi1)*w1 + (l2 + q4)*cos(phi2)*w2 + sin(phi2)*u4;
  0 = l1*sin(phi1)*w1 + (l2 + q4)*sin(phi2)*w2 + v3 - cos(phi2)*u4;
  0 = w1 - Omega;
end SliderCrank;
