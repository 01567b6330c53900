// Draws the Gaussians with WebGL 2: back to front, one quad each, blended in half floats.

const VERTEX = `#version 300 es
precision highp float;
precision highp int;
uniform highp sampler2D points;    // per Gaussian: mean and opacity; covariance in two texels
uniform highp sampler2D colors;    // spherical harmonics, COEFFICIENTS texels of rgb
uniform highp sampler2D objects;   // per object: offset and brightness, display colour and its share
uniform mat3 rotation;             // rows: the camera's axes in the world
uniform vec3 center;
uniform vec4 lens;                 // fx, fy, cx, cy in pixels
uniform vec2 size;                 // of the picture, pixels
uniform vec2 nearFar;
in vec2 corner;
in uint index;
out vec2 position;
out vec4 color;

vec4 read(highp sampler2D from, int place) {
  int width = textureSize(from, 0).x;
  return texelFetch(from, ivec2(place % width, place / width), 0);
}

vec3 radiance(int row, vec3 d) {
  int start = row * COEFFICIENTS;
  vec3 value = 0.28209479177387814 * read(colors, start).rgb + 0.5;
#if COEFFICIENTS > 1
  value += 0.4886025119029199 * (-d.y * read(colors, start + 1).rgb + d.z * read(colors, start + 2).rgb
    - d.x * read(colors, start + 3).rgb);
#endif
#if COEFFICIENTS > 4
  float xx = d.x * d.x, yy = d.y * d.y, zz = d.z * d.z;
  value += 1.0925484305920792 * (d.x * d.y * read(colors, start + 4).rgb
    - d.y * d.z * read(colors, start + 5).rgb - d.x * d.z * read(colors, start + 7).rgb)
    + 0.31539156525252005 * (2. * zz - xx - yy) * read(colors, start + 6).rgb
    + 0.5462742152960396 * (xx - yy) * read(colors, start + 8).rgb;
#endif
#if COEFFICIENTS > 9
  value += -0.5900435899266435 * d.y * (3. * xx - yy) * read(colors, start + 9).rgb
    + 2.890611442640554 * d.x * d.y * d.z * read(colors, start + 10).rgb
    - 0.4570457994644658 * d.y * (4. * zz - xx - yy) * read(colors, start + 11).rgb
    + 0.3731763325901154 * d.z * (2. * zz - 3. * xx - 3. * yy) * read(colors, start + 12).rgb
    - 0.4570457994644658 * d.x * (4. * zz - xx - yy) * read(colors, start + 13).rgb
    + 1.445305721320277 * d.z * (xx - yy) * read(colors, start + 14).rgb
    - 0.5900435899266435 * d.x * (xx - 3. * yy) * read(colors, start + 15).rgb;
#endif
  return max(value, 0.);
}

void main() {
  int row = int(index);
  vec4 first = read(points, 3 * row), second = read(points, 3 * row + 1), third = read(points, 3 * row + 2);
  int object = int(third.z);
  vec4 place = read(objects, 2 * object), tint = read(objects, 2 * object + 1);
  gl_Position = vec4(2., 2., 2., 1.);
  vec3 fromCenter = first.xyz + place.xyz - center;
  vec3 p = rotation * fromCenter;
  if (place.w <= 0. || p.z < nearFar.x || p.z > nearFar.y) return;
  // As render/reference.py: the slope at which the covariance is projected stays near the picture.
  vec2 slope = p.xy / p.z, margin = 0.15 * size / lens.xy;
  vec2 cut = clamp(slope, -lens.zw / lens.xy - margin, (size - lens.zw) / lens.xy + margin);
  vec3 right = vec3(rotation[0].x, rotation[1].x, rotation[2].x);
  vec3 down = vec3(rotation[0].y, rotation[1].y, rotation[2].y);
  vec3 forward = vec3(rotation[0].z, rotation[1].z, rotation[2].z);
  mat3 covariance = mat3(second.x, second.y, second.z, second.y, second.w, third.x, second.z, third.x, third.y);
  vec3 a = lens.x / p.z * (right - cut.x * forward), b = lens.y / p.z * (down - cut.y * forward);
  float xx = dot(a, covariance * a) + EPS2D, yy = dot(b, covariance * b) + EPS2D;
  float xy = dot(a, covariance * b);
  // Half axes of the ellipse at which alpha is the least that is drawn.
  float opacity = first.w;
  if (opacity < ALPHA_MIN) return;
  float reach = sqrt(2. * log(opacity / ALPHA_MIN));
  float middle = 0.5 * (xx + yy), apart = length(vec2(0.5 * (xx - yy), xy));
  float major = middle + apart, minor = max(middle - apart, 1e-6);
  vec2 axis = apart > 1e-9 ? normalize(vec2(xy, major - xx) + vec2(xy == 0. && xx >= yy ? 1. : 0., 0.)) : vec2(1., 0.);
  position = corner * reach;
  vec2 pixel = slope * lens.xy + lens.zw
    + position.x * sqrt(major) * axis + position.y * sqrt(minor) * vec2(-axis.y, axis.x);
  gl_Position = vec4(2. * pixel.x / size.x - 1., 1. - 2. * pixel.y / size.y, 0., 1.);
  vec3 own = radiance(row, normalize(fromCenter));
  color = vec4(place.w * mix(own, tint.rgb, tint.a), opacity);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
in vec2 position;
in vec4 color;
out vec4 result;
void main() {
  float alpha = min(ALPHA_MAX, color.a * exp(-0.5 * dot(position, position)));
  if (alpha < ALPHA_MIN) discard;
  result = vec4(color.rgb * alpha, alpha);
}`;

const COPY_VERTEX = `#version 300 es
in vec2 corner;
void main() { gl_Position = vec4(corner, 0., 1.); }`;

const COPY_FRAGMENT = `#version 300 es
precision highp float;
uniform highp sampler2D picture;
out vec4 result;
void main() { result = vec4(texelFetch(picture, ivec2(gl_FragCoord.xy), 0).rgb, 1.); }`;

const TEXTURE_WIDTH = 2048;

class Drawing {
  constructor(canvas, scene) {
    const gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("this browser has no WebGL 2");
    this.gl = gl;
    this.scene = scene;
    const defines = { COEFFICIENTS: scene.coefficients, ALPHA_MIN, ALPHA_MAX, EPS2D };
    this.program = this.build(VERTEX, FRAGMENT, defines);
    this.copying = this.build(COPY_VERTEX, COPY_FRAGMENT, {});
    this.canBlendHalves = Boolean(
      gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float"),
    );
    const count = scene.objects.length;
    this.points = this.texture(this.pointTexels(), 4);
    this.colors = this.texture(scene.sh, 3);
    this.states = gl.createTexture();
    this.order = new Uint32Array(count);
    this.depths = new Float32Array(count);
    this.setUpArrays(count);
  }

  build(vertex, fragment, defines) {
    const gl = this.gl, program = gl.createProgram();
    const lines = Object.entries(defines).map(
      ([name, value]) => `#define ${name} ${name === "COEFFICIENTS" ? value : value.toFixed(8)}\n`,
    );
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source.replace("\n", "\n" + lines.join("")));
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.bindAttribLocation(program, 0, "corner");
    gl.bindAttribLocation(program, 1, "index");
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    return program;
  }

  pointTexels() {
    const { means, covariances, opacities, objects } = this.scene;
    const texels = new Float32Array(12 * objects.length);
    for (let k = 0; k < objects.length; k++) {
      texels.set(means.subarray(3 * k, 3 * k + 3), 12 * k);
      texels[12 * k + 3] = opacities[k];
      texels.set(covariances.subarray(6 * k, 6 * k + 6), 12 * k + 4);
      texels[12 * k + 10] = objects[k];
    }
    return texels;
  }

  /** A float texture of a row-major list of texels with 3 or 4 channels. */
  texture(values, channels) {
    const gl = this.gl, texture = gl.createTexture();
    const rows = Math.max(1, Math.ceil(values.length / channels / TEXTURE_WIDTH));
    const padded = new Float32Array(rows * TEXTURE_WIDTH * channels);
    padded.set(values);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    this.plainSampling();
    const [inside, outside] = channels === 4 ? [gl.RGBA32F, gl.RGBA] : [gl.RGB32F, gl.RGB];
    gl.texImage2D(gl.TEXTURE_2D, 0, inside, TEXTURE_WIDTH, rows, 0, outside, gl.FLOAT, padded);
    return texture;
  }

  plainSampling() {
    const gl = this.gl;
    for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
      gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
    }
  }

  setUpArrays(count) {
    const gl = this.gl;
    this.arrays = gl.createVertexArray();
    gl.bindVertexArray(this.arrays);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
    this.orderBuffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.orderBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, 4 * count, gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribIPointer(1, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(1, 1);
  }

  /** Half-float picture of the canvas's size to draw into, where the browser can blend those. */
  target(width, height) {
    const gl = this.gl;
    if (!this.canBlendHalves) return null;
    if (this.frame && this.frame.width === width && this.frame.height === height) return this.frame;
    if (this.frame) {
      gl.deleteTexture(this.frame.picture);
      gl.deleteFramebuffer(this.frame.buffer);
    }
    const picture = gl.createTexture(), buffer = gl.createFramebuffer();
    gl.bindTexture(gl.TEXTURE_2D, picture);
    this.plainSampling();
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, picture, 0);
    this.frame = { picture, buffer, width, height };
    return this.frame;
  }

  /** Rows of the Gaussians from far to near, by a counting sort of their depths. */
  sort(viewpoint, state) {
    const { means, objects } = this.scene, { depths, order } = this;
    const [x, y, z] = viewpoint.rotation[2];
    const origin = dot(viewpoint.rotation[2], viewpoint.center);
    const shifts = state.offsets.map((offset) => dot(viewpoint.rotation[2], offset) - origin);
    let low = Infinity, high = -Infinity;
    for (let k = 0; k < objects.length; k++) {
      const depth = x * means[3 * k] + y * means[3 * k + 1] + z * means[3 * k + 2] + shifts[objects[k]];
      depths[k] = depth;
      if (depth < low) low = depth;
      if (depth > high) high = depth;
    }
    const BINS = 1 << 16, factor = (BINS - 1) / Math.max(high - low, 1e-12);
    const ends = new Uint32Array(BINS + 1);
    for (let k = 0; k < depths.length; k++) ends[((high - depths[k]) * factor | 0) + 1]++;
    for (let k = 0; k < BINS; k++) ends[k + 1] += ends[k];
    for (let k = 0; k < depths.length; k++) order[ends[(high - depths[k]) * factor | 0]++] = k;
  }

  draw(viewpoint, state) {
    const gl = this.gl, { width, height } = gl.canvas, frame = this.target(width, height);
    this.sort(viewpoint, state);
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame && frame.buffer);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, frame ? 0 : 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(this.program);
    gl.bindVertexArray(this.arrays);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.orderBuffer);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, this.order);
    this.bind("points", 0, this.points);
    this.bind("colors", 1, this.colors);
    this.bind("objects", 2, this.states);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, 2 * state.hidden.length, 1, 0, gl.RGBA, gl.FLOAT,
      this.stateTexels(state));
    this.plainSampling();
    const at = (name) => gl.getUniformLocation(this.program, name);
    gl.uniformMatrix3fv(at("rotation"), true, viewpoint.rotation.flat());
    gl.uniform3fv(at("center"), viewpoint.center);
    gl.uniform4fv(at("lens"), viewpoint.pixels(width, height));
    gl.uniform2f(at("size"), width, height);
    gl.uniform2f(at("nearFar"), this.scene.near, this.scene.far);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.order.length);
    gl.disable(gl.BLEND);
    if (!frame) return;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.useProgram(this.copying);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, frame.picture);
    gl.uniform1i(gl.getUniformLocation(this.copying, "picture"), 0);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  bind(name, unit, texture) {
    const gl = this.gl;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.uniform1i(gl.getUniformLocation(this.program, name), unit);
  }

  stateTexels(state) {
    const texels = new Float32Array(8 * state.hidden.length);
    for (let k = 0; k < state.hidden.length; k++) {
      const share = state.colored && k ? 0.65 : state.selected.has(k) ? 0.4 : state.hovered === k && k ? 0.2 : 0;
      texels.set([...state.offsets[k], state.hidden[k] ? 0 : 1, ...state.colors[k], share], 8 * k);
    }
    return texels;
  }
}
