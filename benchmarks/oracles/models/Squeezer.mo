model Squeezer "Andrews' squeezing mechanism, seven bodies, six constraints: index 3 (Test Set for IVP Solvers 2.4)"
  constant Real m1 = 0.04325;
  constant Real m2 = 0.00365;
  constant Real m3 = 0.02373;
  constant Real m4 = 0.00706;
  constant Real m5 = 0.07050;
  constant Real m6 = 0.00706;
  constant Real m7 = 0.05498;
  constant Real J1 = 2.194e-6;
  constant Real J2 = 4.410e-7;
  constant Real J3 = 5.255e-6;
  constant Real J4 = 5.667e-7;
  constant Real J5 = 1.169e-5;
  constant Real J6 = 5.667e-7;
  constant Real J7 = 1.912e-5;
  constant Real xa = -0.06934;
  constant Real ya = -0.00227;
  constant Real xb = -0.03635;
  constant Real yb = 0.03273;
  constant Real xc = 0.014;
  constant Real yc = 0.072;
  constant Real c0 = 4530;
  constant Real l0 = 0.07785;
  constant Real d = 0.028;
  constant Real da = 0.0115;
  constant Real e = 0.02;
  constant Real ea = 0.01421;
  constant Real zf = 0.02;
  constant Real fa = 0.01421;
  constant Real rr = 0.007;
  constant Real ra = 0.00092;
  constant Real ss = 0.035;
  constant Real sa = 0.01874;
  constant Real sb = 0.01043;
  constant Real sc = 0.018;
  constant Real sd = 0.02;
  constant Real zt = 0.04;
  constant Real ta = 0.02308;
  constant Real tb = 0.00916;
  constant Real u = 0.04;
  constant Real ua = 0.01228;
  constant Real ub = 0.00449;
  parameter Real mom = 0.033 "drive torque";
  Real beta(start = -0.0617138900142764496358948458001);
  Real theta(start = 0);
  Real gamma(start = 0.455279819163070380255912382449);
  Real phi(start = 0.222668390165885884674473185609);
  Real delta(start = 0.487364979543842550225598953530);
  Real omega(start = -0.222668390165885884674473185609);
  Real epsilon(start = 1.23054744454982119249735015568);
  Real vbeta(start = 0, nominal = 100);
  Real vtheta(start = 0, nominal = 100);
  Real vgamma(start = 0);
  Real vphi(start = 0);
  Real vdelta(start = 0);
  Real vomega(start = 0);
  Real vepsilon(start = 0);
  Real abeta, atheta, agamma, aphi, adelta, aomega, aepsilon "angular accelerations";
  Real lam1, lam2, lam3, lam4, lam5, lam6 "forces in the joints";
  Real xd, yd, length, force, fx, fy "spring";
equation
  der(beta) = vbeta;
  der(theta) = vtheta;
  der(gamma) = vgamma;
  der(phi) = vphi;
  der(delta) = vdelta;
  der(omega) = vomega;
  der(epsilon) = vepsilon;
  der(vbeta) = abeta;
  der(vtheta) = atheta;
  der(vgamma) = agamma;
  der(vphi) = aphi;
  der(vdelta) = adelta;
  der(vomega) = aomega;
  der(vepsilon) = aepsilon;
  xd = sd*cos(gamma) + sc*sin(gamma) + xb;
  yd = sd*sin(gamma) - sc*cos(gamma) + yb;
  length = sqrt((xd - xc)^2 + (yd - yc)^2);
  force = -c0*(length - l0)/length;
  fx = force*(xd - xc);
  fy = force*(yd - yc);
  (m1*ra^2 + m2*(rr^2 - 2*da*rr*cos(theta) + da^2) + J1 + J2)*abeta + (m2*(da^2 - da*rr*cos(theta)) + J2)*atheta
    + lam1*(-rr*sin(beta) + d*sin(beta + theta)) + lam2*(rr*cos(beta) - d*cos(beta + theta))
    + lam3*(-rr*sin(beta) + d*sin(beta + theta)) + lam4*(rr*cos(beta) - d*cos(beta + theta))
    + lam5*(-rr*sin(beta) + d*sin(beta + theta)) + lam6*(rr*cos(beta) - d*cos(beta + theta))
    = mom - m2*da*rr*vtheta*(vtheta + 2*vbeta)*sin(theta);
  (m2*(da^2 - da*rr*cos(theta)) + J2)*abeta + (m2*da^2 + J2)*atheta
    + (lam1 + lam3 + lam5)*d*sin(beta + theta) - (lam2 + lam4 + lam6)*d*cos(beta + theta)
    = m2*da*rr*vbeta^2*sin(theta);
  (m3*(sa^2 + sb^2) + J3)*agamma - lam1*ss*cos(gamma) - lam2*ss*sin(gamma)
    = fx*(sc*cos(gamma) - sd*sin(gamma)) + fy*(sd*cos(gamma) + sc*sin(gamma));
  (m4*(e - ea)^2 + J4)*aphi + (m4*((e - ea)^2 + zt*(e - ea)*sin(phi)) + J4)*adelta
    - lam3*e*cos(phi + delta) - lam4*e*sin(phi + delta)
    = m4*zt*(e - ea)*vdelta^2*cos(phi);
  (m4*((e - ea)^2 + zt*(e - ea)*sin(phi)) + J4)*aphi
    + (m4*(zt^2 + 2*zt*(e - ea)*sin(phi) + (e - ea)^2) + m5*(ta^2 + tb^2) + J4 + J5)*adelta
    + lam3*(-e*cos(phi + delta) + zt*sin(delta)) + lam4*(-e*sin(phi + delta) - zt*cos(delta))
    = -m4*zt*(e - ea)*vphi*(vphi + 2*vdelta)*cos(phi);
  (m6*(zf - fa)^2 + J6)*aomega + (m6*((zf - fa)^2 - u*(zf - fa)*sin(omega)) + J6)*aepsilon
    + lam5*zf*sin(omega + epsilon) - lam6*zf*cos(omega + epsilon)
    = -m6*u*(zf - fa)*vepsilon^2*cos(omega);
  (m6*((zf - fa)^2 - u*(zf - fa)*sin(omega)) + J6)*aomega
    + (m6*((zf - fa)^2 - 2*u*(zf - fa)*sin(omega) + u^2) + m7*(ua^2 + ub^2) + J6 + J7)*aepsilon
    + lam5*(zf*sin(omega + epsilon) - u*cos(epsilon)) + lam6*(-zf*cos(omega + epsilon) - u*sin(epsilon))
    = m6*u*(zf - fa)*vomega*(vomega + 2*vepsilon)*cos(omega);
  0 = rr*cos(beta) - d*cos(beta + theta) - ss*sin(gamma) - xb;
  0 = rr*sin(beta) - d*sin(beta + theta) + ss*cos(gamma) - yb;
  0 = rr*cos(beta) - d*cos(beta + theta) - e*sin(phi + delta) - zt*cos(delta) - xa;
  0 = rr*sin(beta) - d*sin(beta + theta) + e*cos(phi + delta) - zt*sin(delta) - ya;
  0 = rr*cos(beta) - d*cos(beta + theta) - zf*cos(omega + epsilon) - u*sin(epsilon) - xa;
  0 = rr*sin(beta) - d*sin(beta + theta) - zf*sin(omega + epsilon) + u*cos(epsilon) - ya;
end Squeezer;
