//! Little-endian bytes of what a cache keeps. Reading trusts nothing: every length is compared with what is left.
use crate::geometry::{Aabb, IVec3, Mesh, Vec3};

/// Why bytes could not be read.
pub type Fault = &'static str;

/// Coordinates of scenes are smaller, metres.
const MAX_COORDINATE: f32 = 1e6;

#[derive(Default)]
pub struct Writer(pub Vec<u8>);

impl Writer {
    pub fn u8(&mut self, value: u8) {
        self.0.push(value);
    }
    pub fn u32(&mut self, value: u32) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }
    pub fn u64(&mut self, value: u64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }
    pub fn u128(&mut self, value: u128) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }
    pub fn f32(&mut self, value: f32) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }
    pub fn vec3(&mut self, value: Vec3) {
        value.to_array().into_iter().for_each(|x| self.f32(x));
    }
    pub fn ivec3(&mut self, value: IVec3) {
        value
            .to_array()
            .into_iter()
            .for_each(|x| self.u32(x as u32));
    }
    pub fn aabb(&mut self, value: &Aabb) {
        self.vec3(value.min);
        self.vec3(value.max);
    }
    pub fn text(&mut self, value: &str) {
        self.u64(value.len() as u64);
        self.0.extend_from_slice(value.as_bytes());
    }
    pub fn texts(&mut self, values: &[String]) {
        self.u64(values.len() as u64);
        values.iter().for_each(|v| self.text(v));
    }
    pub fn mesh(&mut self, mesh: &Mesh) {
        self.0
            .reserve(12 * (mesh.vertices.len() + mesh.triangles.len()) + 16);
        self.u64(mesh.vertices.len() as u64);
        mesh.vertices.iter().for_each(|v| self.vec3(*v));
        self.u64(mesh.triangles.len() as u64);
        mesh.triangles
            .as_flattened()
            .iter()
            .for_each(|i| self.u32(*i));
    }
}

pub struct Reader<'a>(pub &'a [u8]);

impl<'a> Reader<'a> {
    pub fn take(&mut self, count: usize) -> Result<&'a [u8], Fault> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or("cut off")?;
        self.0 = rest;
        Ok(taken)
    }
    fn array<const N: usize>(&mut self) -> Result<[u8; N], Fault> {
        let (taken, rest) = self.0.split_first_chunk().ok_or("cut off")?;
        self.0 = rest;
        Ok(*taken)
    }
    pub fn u8(&mut self) -> Result<u8, Fault> {
        Ok(self.array::<1>()?[0])
    }
    pub fn u32(&mut self) -> Result<u32, Fault> {
        Ok(u32::from_le_bytes(self.array()?))
    }
    pub fn u64(&mut self) -> Result<u64, Fault> {
        Ok(u64::from_le_bytes(self.array()?))
    }
    pub fn u128(&mut self) -> Result<u128, Fault> {
        Ok(u128::from_le_bytes(self.array()?))
    }
    pub fn f32(&mut self) -> Result<f32, Fault> {
        Ok(f32::from_le_bytes(self.array()?))
    }
    /// A number of things of `size` bytes each, if so many bytes are left.
    pub fn count(&mut self, size: usize) -> Result<usize, Fault> {
        let count = usize::try_from(self.u64()?).map_err(|_| "a length beyond memory")?;
        match count.checked_mul(size) {
            Some(bytes) if bytes <= self.0.len() => Ok(count),
            _ => Err("a length beyond the end"),
        }
    }
    /// A finite number of a sensible size.
    pub fn coordinate(&mut self) -> Result<f32, Fault> {
        let value = self.f32()?;
        if value.abs() <= MAX_COORDINATE {
            Ok(value)
        } else {
            Err("a coordinate that is not finite")
        }
    }
    pub fn point(&mut self) -> Result<Vec3, Fault> {
        Ok(Vec3::new(
            self.coordinate()?,
            self.coordinate()?,
            self.coordinate()?,
        ))
    }
    pub fn ivec3(&mut self) -> Result<IVec3, Fault> {
        Ok(IVec3::new(
            self.u32()? as i32,
            self.u32()? as i32,
            self.u32()? as i32,
        ))
    }
    /// A finite box, or the empty one.
    pub fn aabb(&mut self) -> Result<Aabb, Fault> {
        let mut ahead = Reader(self.0);
        let raw: [f32; 6] = [
            ahead.f32()?,
            ahead.f32()?,
            ahead.f32()?,
            ahead.f32()?,
            ahead.f32()?,
            ahead.f32()?,
        ];
        let (min, max) = (Vec3::from_slice(&raw[..3]), Vec3::from_slice(&raw[3..]));
        if (min, max) == (Aabb::EMPTY.min, Aabb::EMPTY.max) {
            self.0 = ahead.0;
            return Ok(Aabb::EMPTY);
        }
        let found = Aabb::new(self.point()?, self.point()?);
        if found.is_empty() {
            return Err("a box without content");
        }
        Ok(found)
    }
    pub fn text(&mut self) -> Result<String, Fault> {
        let count = self.count(1)?;
        let bytes = self.take(count)?.to_vec();
        String::from_utf8(bytes).map_err(|_| "a text that is not UTF-8")
    }
    pub fn texts(&mut self) -> Result<Vec<String>, Fault> {
        let count = self.count(8)?;
        (0..count).map(|_| self.text()).collect()
    }
    pub fn mesh(&mut self) -> Result<Mesh, Fault> {
        let count = self.count(12)?;
        let vertices: Vec<Vec3> = floats(self.take(12 * count)?)
            .map(Vec3::from_array)
            .collect();
        if !vertices
            .iter()
            .all(|v| v.abs().cmple(Vec3::splat(MAX_COORDINATE)).all())
        {
            return Err("a vertex that is not finite");
        }
        let count = self.count(12)?;
        let triangles: Vec<[u32; 3]> = self
            .take(12 * count)?
            .as_chunks::<12>()
            .0
            .iter()
            .map(|t| {
                let corner = |k: usize| u32::from_le_bytes([t[k], t[k + 1], t[k + 2], t[k + 3]]);
                [corner(0), corner(4), corner(8)]
            })
            .collect();
        if triangles
            .as_flattened()
            .iter()
            .any(|i| *i as usize >= vertices.len())
        {
            return Err("a triangle with a missing corner");
        }
        Ok(Mesh {
            vertices,
            triangles,
        })
    }
}

/// Groups of `N` floats; what does not fill a group is left out.
pub fn floats<const N: usize>(bytes: &[u8]) -> impl Iterator<Item = [f32; N]> + '_ {
    bytes.chunks_exact(4 * N).map(|group| {
        let mut values = [0.0; N];
        for (value, four) in values.iter_mut().zip(group.as_chunks::<4>().0) {
            *value = f32::from_le_bytes(*four);
        }
        values
    })
}
