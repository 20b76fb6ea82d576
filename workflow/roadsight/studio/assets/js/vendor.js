export * from "../vendor/three.js";
