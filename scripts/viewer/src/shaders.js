// Points as discs of the size of their spacing, and shading by depth alone (eye-dome lighting,
// Boucheny 2009): a pixel is dark where its neighbours are nearer.

export const POINT_VERTEX = `
uniform float uSize, uScale, uMode, uCut;
uniform vec3 uColor, uUp;
uniform sampler2D uRamp;
in vec3 aRgb;
in float aResidual;
out vec3 vColor;
out float vHeight;
void main() {
  vec4 world = modelMatrix * vec4(position, 1.0);
  vec4 view = viewMatrix * world;
  vHeight = dot(world.xyz, uUp);
  gl_Position = projectionMatrix * view;
  gl_PointSize = clamp(uSize * uScale / max(-view.z, 1e-6), 1.5, 24.0);
  vColor = uColor;
  if (uMode > 1.5) {
    if (aResidual < 0.9985) vColor = texture(uRamp, vec2(clamp(aResidual * RESIDUAL_GAIN, 0.004, 0.996), 0.5)).rgb;
  } else if (uMode > 0.5) vColor = aRgb;
}`;

export const POINT_FRAGMENT = `
uniform float uCut;
in vec3 vColor;
in float vHeight;
out vec4 color;
void main() {
  vec2 d = gl_PointCoord - 0.5;
  if (vHeight > uCut || dot(d, d) > 0.25) discard;
  color = vec4(vColor, 1.0);
}`;

export const SCREEN_VERTEX = `
out vec2 vUv;
void main() { vUv = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }`;

export const SCREEN_FRAGMENT = `
uniform sampler2D uImage, uDepth;
uniform vec2 uStep;
uniform vec3 uGround;
uniform float uNear, uFar, uStrength;
in vec2 vUv;
out vec4 color;
float logDepth(vec2 at) {
  float d = texture(uDepth, at).r;
  float far = d >= 1.0 ? uFar : uNear * uFar / (uFar - d * (uFar - uNear));
  return log2(far);
}
void main() {
  vec4 image = texture(uImage, vUv);
  float here = logDepth(vUv), sum = 0.0;
  if (uStrength > 0.0 && image.a > 0.0) {
    for (int i = 0; i < 8; i++) {
      float angle = float(i) * 0.7853981634;
      sum += max(0.0, here - logDepth(vUv + uStep * vec2(cos(angle), sin(angle))));
    }
  }
  float shade = exp(-uStrength * min(sum / 8.0, 0.022));
  color = vec4(mix(uGround, image.rgb * shade, image.a), 1.0);
}`;
