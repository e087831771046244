function [X, C, I, out] = leanboom_model(inp, par)
% Model function for dpm: a crane's stage from the tables that benchmarks/export_tables.py writes.
%   inp.X{1}  position of the redundant cylinder [m]      inp.U{1}  its acceleration [m/s^2]
%   inp.X{2}  its velocity [m/s]                          inp.W{1}  number of the stage, from 1
%   X         state at the next stage    C{1}  cost [J]    I         1 where a limit is broken
  k = max(1, round(inp.W{1}(1)));  % dpm calls a model with zeros before it begins
  c = inp.X{1}; w = inp.X{2}; u = inp.U{1};
  X{1} = c + par.step * (w + 0.5 * par.step * u);
  X{2} = w + par.step * u;

  % Tables are linear between position nodes: node i, share x of the way to the next.
  last = size(par.coefficients, 2);
  x = min(max((c - par.c_lo(k)) / par.dc(k), 0), last - 1);
  i = min(floor(x), last - 2);
  x = x - i;
  i = i + 1;

  flow = par.fixed_flow(k) * ones(size(c));
  pressure = par.fixed_pressure(k) * ones(size(c));
  broken = between(par.outside(k, :), i, x) > 0;
  for m = 1:size(par.coefficients, 3)
    a = cell(1, 11);
    for q = 1:11
      a{q} = between(par.coefficients(k, :, m, q), i, x);
    end
    [a0, a1, b0, b1, b2, b3, f0, f1, f2, f3, coulomb] = a{:};
    v = a0 + a1 .* w;
    acceleration = b0 + w .* (b1 + w .* b2) + b3 .* u;
    force = f0 + w .* (f1 + w .* f2) + f3 .* u;
    force = force + coulomb .* tanh(par.sharpness(m) * v) + par.viscous(m) * v;
    broken = broken | abs(v) > par.velocity_limit(m) | abs(acceleration) > par.acceleration_limit(m);
    flow = flow + max(par.area_out(m) * v, -par.area_in(m) * v);
    asked = (par.gain_out(m) * force + par.back_out(m)) .* (v > par.epsilon);
    asked = asked + (par.back_in(m) - par.gain_in(m) * force) .* (v < -par.epsilon);
    pressure = max(pressure, asked .* (force .* v > 0));
  end
  if strcmp(par.pump, 'ls')
    supply = pressure + par.margin;
  else
    supply = par.supply_cp;
  end
  power = supply .* flow / par.efficiency + par.idle + par.leak * supply + par.drag * flow .* flow;
  C{1} = par.step * power;
  I = double(broken);
  out.U{1} = u;
end

function y = between(table, i, x)
% A table over the position nodes at node i and share x of the way to the next, of the shape of i.
  table = table(:);
  y = (1 - x) .* reshape(table(i), size(i)) + x .* reshape(table(i + 1), size(i));
end
