// The dissertation's simulated scene (section 5.4.1): a hemisphere 80 pixels across in images of
// 100 x 100, seen along z from far away, under one distant light at a time. One picture holds the
// images of all lights, side by side: each has a sphere of its own that no other light reaches.
// Frame k is for the k-th ratio k_d / k_s, with k_d + k_s = WHOLE so that nothing clips.
//
// facts.inc (written by facts.py) declares LIGHTS, unit vectors from the surface with z away from
// the camera; COLUMNS; WHOLE; RATIO_FIRST and RATIO_STEP, exponents of ten. The command line
// declares ALPHA.
//
// `specular` without `metallic` is (n.h)^(1 / roughness), with no n.l: Blinn-Phong. No ambient
// light, no light fall-off, no shadows: a hemisphere casts none on itself.
#version 3.7;
global_settings { assumed_gamma 1 }
#include "facts.inc"

#declare Side = 2.5;
#declare Rows = ceil(dimension_size(LIGHTS, 1) / COLUMNS);
#declare Ratio = pow(10, RATIO_FIRST + RATIO_STEP * (frame_number - 1));
#declare Material = finish {
  ambient 0
  emission 0
  diffuse WHOLE * Ratio / (1 + Ratio)
  brilliance 1
  specular WHOLE / (1 + Ratio)
  roughness 1 / ALPHA
}

camera {
  orthographic
  location <0, 0, -10>
  direction z
  right COLUMNS * Side * x
  up Rows * Side * y
}

#for (K, 0, dimension_size(LIGHTS, 1) - 1)
  #declare Centre = Side * <mod(K, COLUMNS) - (COLUMNS - 1) / 2, (Rows - 1) / 2 - floor(K / COLUMNS), 0>;
  light_group {
    light_source { Centre + 1000 * LIGHTS[K] rgb 1 parallel point_at Centre }
    sphere { Centre, 1 no_shadow pigment { rgb 1 } finish { Material } }
    global_lights off
  }
#end
