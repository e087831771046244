% Plan with dpm on exported tables. Needs dpm.m and leanboom_model.m on the path and tables.mat in this folder;
% writes motion.mat, which `python -m benchmarks.export_tables --judge motion.mat` measures.
par = load('tables.mat');
stages = numel(par.time) - 1;

grd.Nx{1} = size(par.coefficients, 2);
grd.Xn{1}.lo = par.c_lo(:)';
grd.Xn{1}.hi = par.c_lo(:)' + (grd.Nx{1} - 1) * par.dc(:)';
grd.X0{1} = par.start;
grd.XN{1}.lo = grd.Xn{1}.lo(end);
grd.XN{1}.hi = grd.Xn{1}.hi(end);

grd.Nx{2} = par.velocities;
grd.Xn{2}.lo = par.w_lo(:)';
grd.Xn{2}.hi = par.w_lo(:)' + (par.velocities - 1) * par.dw(:)';
grd.X0{2} = 0;
grd.XN{2}.lo = -0.5 * par.dw(end);  % at rest: the node at zero alone
grd.XN{2}.hi = 0.5 * par.dw(end);

grd.Nu{1} = 61;
grd.Un{1}.lo = -par.acceleration_limit(end);  % the redundant cylinder comes last
grd.Un{1}.hi = par.acceleration_limit(end);

prb.Ts = par.step;
prb.N = stages;
prb.N0 = 1;
prb.W{1} = 1:stages;

options = dpm();
options.MyInf = par.infinite;
options.BoundaryMethod = 'none';
options.Waitbar = 'off';

began = time();
[res, dyn] = dpm(@leanboom_model, par, grd, prb, options);
seconds = time() - began;

task = par.task; pump = par.pump; step = par.step; start = par.start;
velocity = res.X{2}(1:stages + 1);
save('-mat7-binary', 'motion.mat', 'task', 'pump', 'step', 'start', 'velocity', 'seconds');
printf('planned in %.1f s\n', seconds);
